"""The device, judged by clients that others wrote: viva-genicam and Aravis."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_mocks.gige import GigeFaults
from hil_mocks.practice_bench import PracticeBench
from tests.hil_mocks.gige_bench import expected_image, gige_bench
from tests.hil_mocks.gige_introducer import introduced

SETTINGS = [(500.0, 0.0), (8000.0, 3.0), (12_000.0, 12.0)]
POP_US = 2_000_000
SOCKET_BUFFER_BYTES = 4 << 20


@contextmanager
def whole_bench() -> Iterator[PracticeBench]:
    """A bench with the frames of a Manta G-046."""
    with gige_bench(simulated__width_px=780, simulated__height_px=580) as bench:
        yield bench


@contextmanager
def viva_camera(bench: PracticeBench) -> Iterator[Any]:
    viva_genicam = pytest.importorskip("viva_genicam")
    with introduced(bench.camera.address):
        (info,) = viva_genicam.discover(timeout_ms=300, iface="127.0.0.1")
    assert info.ip == bench.camera.address
    with viva_genicam.connect_gige(info) as camera:
        yield camera


@pytest.mark.slow
@pytest.mark.parametrize(("exposure_us", "gain_db"), SETTINGS)
@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono12", "Mono12Packed"])
def test_viva_genicam_reads_the_frames_of_the_source(
    pixel_format: str, exposure_us: float, gain_db: float
) -> None:
    with whole_bench() as bench, viva_camera(bench) as camera:
        assert camera.skipped() == []  # it understands every node of the description
        camera.set("PixelFormat", pixel_format)
        camera.set_exposure_time(exposure_us)
        camera.set_gain(gain_db)
        with camera.stream(iface="127.0.0.1", packet_size=1500) as frames:
            for _ in range(3):
                frame = frames.next_frame(timeout_ms=2000)
                np.testing.assert_array_equal(
                    frame.to_numpy(),
                    expected_image(
                        bench,
                        pixel_format,
                        index=frame.block_id - 1,
                        exposure_us=exposure_us,
                        gain_db=gain_db,
                    ),
                )


@pytest.mark.slow
def test_viva_genicam_finds_the_packet_size_of_the_link() -> None:
    with gige_bench() as bench, viva_camera(bench) as camera:
        with camera.stream(iface="127.0.0.1", auto_packet_size=True) as frames:
            assert next(iter(frames)).is_complete
        assert camera.get("GevSCPSPacketSize") == "1500"


@pytest.mark.slow
def test_viva_genicam_is_refused_while_another_client_holds_control() -> None:
    viva_genicam = pytest.importorskip("viva_genicam")
    with gige_bench() as bench, viva_camera(bench):
        with introduced(bench.camera.address):
            (info,) = viva_genicam.discover(timeout_ms=300, iface="127.0.0.1")
        with pytest.raises(viva_genicam.TransportError):
            viva_genicam.connect_gige(info)


def test_viva_genicam_gets_lost_packets_again() -> None:
    with gige_bench() as bench, viva_camera(bench) as camera:
        bench.camera.faults = GigeFaults(seed=2, packet_loss_rate=0.05)
        camera.set_exposure_time(8000.0)
        with camera.stream(iface="127.0.0.1", packet_size=576) as frames:
            frame = next(iter(frames))
            assert frame.is_complete
            np.testing.assert_array_equal(
                frame.to_numpy(),
                expected_image(bench, "Mono8", index=frame.block_id - 1),
            )
            assert frames.stats() is not None


@pytest.fixture
def aravis() -> Any:
    gi = pytest.importorskip("gi")
    try:
        gi.require_version("Aravis", "0.8")
    except ValueError:
        pytest.skip("Aravis 0.8 is not installed")
    from gi.repository import Aravis

    return Aravis


class AravisStream:
    """Bare Aravis: buffers in, frames out."""

    def __init__(self, aravis: Any, camera: Any) -> None:
        self._aravis = aravis
        self._camera = camera
        camera.gv_set_stream_options(aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        self.stream = camera.create_stream(None, None)
        self.stream.set_property("socket-buffer", aravis.GvStreamSocketBuffer.FIXED)
        self.stream.set_property("socket-buffer-size", SOCKET_BUFFER_BYTES)
        for _ in range(8):
            self.stream.push_buffer(aravis.Buffer.new_allocate(camera.get_payload()))
        camera.start_acquisition()

    def frame(self, dtype: type = np.uint8) -> tuple[int, NDArray[Any]]:
        """Block id and bytes of the next complete frame."""
        for _ in range(20):
            buffer = self.stream.timeout_pop_buffer(POP_US)
            assert buffer is not None
            is_complete = buffer.get_status() == self._aravis.BufferStatus.SUCCESS
            block_id, data = buffer.get_frame_id(), b""
            if is_complete:
                data = bytes(buffer.get_data())
            self.stream.push_buffer(buffer)
            if is_complete:
                return block_id, np.frombuffer(data, dtype)
        raise AssertionError("no complete frame")


def unpacked(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Pixels of a packed format, by hand after GigE Vision 1.2."""
    triples = packed.reshape(-1, 3).astype(np.uint16)
    first = triples[:, 0] << 4 | triples[:, 1] & 0x0F
    second = triples[:, 2] << 4 | triples[:, 1] >> 4
    return np.stack([first, second], axis=1).ravel()


@pytest.mark.parametrize(
    ("bayer_order", "pixel_format"),
    [(None, name) for name in ("Mono8", "Mono12", "Mono12Packed", "Mono16")]
    + [
        (order, f"Bayer{order}{depth}")
        for order in ("GR", "RG", "GB", "BG")
        for depth in ("8", "12", "12Packed")
    ],
)
def test_aravis_reads_the_frames_of_the_source_in_every_format(
    aravis: Any, bayer_order: str | None, pixel_format: str
) -> None:
    with gige_bench(bayer_order=bayer_order) as bench:
        bench.place("flat")
        camera = aravis.Camera.new(bench.camera.address)
        assert pixel_format in camera.dup_available_pixel_formats_as_strings()
        camera.set_pixel_format_from_string(pixel_format)
        camera.gv_set_packet_size(1500)
        is_packed = pixel_format.endswith("Packed")
        dtype = np.uint8 if is_packed or pixel_format.endswith("8") else np.uint16
        for acquisition, (exposure_us, gain_db) in enumerate(SETTINGS, start=1):
            camera.set_exposure_time(exposure_us)
            camera.set_gain(gain_db)
            stream = AravisStream(aravis, camera)
            block_id, image = stream.frame(dtype)
            camera.stop_acquisition()
            del stream
            expected = expected_image(
                bench,
                pixel_format,
                index=block_id - 1,
                acquisition=acquisition,
                exposure_us=exposure_us,
                gain_db=gain_db,
            )
            image = unpacked(image) if is_packed else image
            np.testing.assert_array_equal(image.reshape(expected.shape), expected)
        del camera


def test_aravis_negotiates_the_packet_size_of_the_link(aravis: Any) -> None:
    for mtu, size in ((1500, 1500), (9000, 8228)):
        with gige_bench(link_mtu_bytes=mtu) as bench:
            camera = aravis.Camera.new(bench.camera.address)
            assert camera.gv_get_packet_size() == 8228
            camera.gv_set_packet_size(1500)
            assert camera.gv_auto_packet_size() == pytest.approx(size, abs=16)
            del camera


def test_aravis_gets_lost_packets_again(aravis: Any) -> None:
    with gige_bench(simulated__width_px=400, simulated__height_px=300) as bench:
        camera = aravis.Camera.new(bench.camera.address)
        camera.gv_set_packet_size(1500)
        camera.set_exposure_time(8000.0)
        bench.camera.faults = GigeFaults(seed=3, packet_loss_rate=0.02)
        stream = AravisStream(aravis, camera)
        for _ in range(10):
            block_id, image = stream.frame()
            expected = expected_image(bench, "Mono8", index=block_id - 1)
            np.testing.assert_array_equal(image.reshape(expected.shape), expected)
        assert stream.stream.get_info_uint64_by_name("n_resent_packets") > 0
        camera.stop_acquisition()
        del stream, camera


def test_a_second_aravis_does_not_control(aravis: Any) -> None:
    with gige_bench() as bench:
        first = aravis.Camera.new(bench.camera.address)
        second = aravis.Camera.new(bench.camera.address)
        assert first.get_device().is_controller()
        assert not second.get_device().is_controller()
        del first, second


@pytest.mark.slow
def test_the_whole_frame_is_streamed_at_the_full_rate(aravis: Any) -> None:
    with whole_bench() as bench:
        camera = aravis.Camera.new(bench.camera.address)
        camera.set_pixel_format_from_string("Mono12")
        camera.gv_set_packet_size(1500)
        camera.set_exposure_time(8000.0)
        camera.set_frame_rate(67.5)
        stream = AravisStream(aravis, camera)
        ids = [stream.frame()[0] for _ in range(136)]
        camera.stop_acquisition()
        del stream, camera
    # 135 if none is lost; a machine that does other things too may lose some.
    assert ids[-1] - ids[0] <= 160
