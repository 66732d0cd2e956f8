"""What a file is that no reader reads, told from its first bytes, with what to do instead."""

_AS_TIFF = "which cannot be read; save the image as TIFF"
_KNOWN = (
    (b"\xff\x0a", f"a JPEG XL image, {_AS_TIFF}"),
    (b"\0\0\0\x0cJXL ", f"a JPEG XL image, {_AS_TIFF}"),
    (b"II\xbc", f"a JPEG XR image, {_AS_TIFF}"),
    (b"8BPS", f"a Photoshop document, {_AS_TIFF} without layers"),
    (b"ZISRAWFILE", f"a CZI microscope file, {_AS_TIFF}"),
    (b"\xda\xce\xbe\x0a", f"an ND2 microscope file, {_AS_TIFF}"),
    (b"LUCAM-RECORDER", "a SER film, which cannot be read; save its frames as TIFF or FITS"),
    (b"#?RADIANCE", "a Radiance picture, which cannot be read; save it as OpenEXR or TIFF"),
    (b"#?RGBE", "a Radiance picture, which cannot be read; save it as OpenEXR or TIFF"),
    (b"\x89HDF\r\n\x1a\n", f"an HDF5 file, {_AS_TIFF}"),
    (b"MATLAB ", f"a MATLAB file, {_AS_TIFF}"),
    (b"\x93NUMPY", f"an array of numpy, {_AS_TIFF}, or give the array in Python"),
    (
        b"\0\x05\x16\x07",
        "what macOS keeps beside a photograph, not the photograph itself; "
        "give the file of the same name without the leading ._",
    ),
    (
        b"version https://git-lfs",
        "a pointer of Git LFS in place of the photograph; fetch it with git lfs pull",
    ),
    (b"PK\x03\x04", "an archive, not a photograph; unpack it"),
)
_WEB_PAGE = (b"<!doctype html", b"<html")
_HEIC = (b"heic", b"heix", b"mif1", b"msf1", b"hevc")
_DOCUMENTS = (b"%!PS", b"%PDF", b"\xc5\xd0\xd3\xc6")
_JPEG = b"\xff\xd8\xff"
_LOSSLESS = (0xC3, 0xC7, 0xCB, 0xCF, 0xF7)
_BASELINE_AND_PROGRESSIVE = (0xC0, 0xC1, 0xC2, 0xC9, 0xCA)


def unread_kind(data: bytes) -> str | None:
    """Return what a file is and what to do, in words; None for what is not known either."""
    if not data:
        return "an empty file"
    for signature, said in _KNOWN:
        if data.startswith(signature):
            return said
    if data[128:132] == b"DICM":
        return f"a DICOM file, {_AS_TIFF}"
    if data[4:8] == b"ftyp":
        if data[8:12] in _HEIC:
            return "a HEIC photograph, which cannot be read; save it as JPEG or TIFF"
        return (
            "a video, or a picture in the same family of formats, which cannot be read; save the "
            "frame as TIFF"
        )
    if data.startswith(b"RIFF") and data[8:12] == b"AVI ":
        return "a video, which cannot be read; save its frames as TIFF"
    if data.startswith(_DOCUMENTS):
        return "a PostScript or PDF document, not a photograph"
    if data.lstrip()[:16].lower().startswith(_WEB_PAGE):
        return "a web page, not a photograph; was the download refused?"
    return _unread_jpeg(data) if data.startswith(_JPEG) else None


def _unread_jpeg(data: bytes) -> str:
    """A JPEG that libjpeg does not take: ITU-T T.81, B.2.2, and T.87."""
    at = 2
    while at + 5 <= len(data) and data[at] == 0xFF:
        marker, depth = data[at + 1], data[at + 4]
        if marker in _LOSSLESS:
            return f"a lossless JPEG, {_AS_TIFF}"
        if marker in _BASELINE_AND_PROGRESSIVE and depth != 8:
            return f"a JPEG of {depth} bits, {_AS_TIFF}"
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return "a damaged JPEG"
