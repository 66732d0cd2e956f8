"""The features of the simulated GigE camera: one table for its registers and its description.

Names are those of a Manta (vendor names beside SFNC ones); the addresses are our own.

References
----------
GenICam Standard Features Naming Convention (SFNC) 2.7, EMVA, 2021.
"""

from collections.abc import Iterator
from dataclasses import replace

from hil_mocks.gige.feature import Feature
from hil_mocks.gige.pixels import PIXEL_LAYOUTS, pixel_formats_of

__all__ = ["DEVICE_PAGE", "features_of"]

DEVICE_PAGE = 0xA000
"""Where the registers of the device itself begin (GigE Vision 2.0, section 28)."""


def features_of(bayer_order: str | None, *, has_temperature: bool) -> tuple[Feature, ...]:
    """The features of a camera, in the order of its description."""
    return tuple(_features(bayer_order, has_temperature=has_temperature))


def _features(bayer_order: str | None, *, has_temperature: bool) -> Iterator[Feature]:
    yield from _image_format(bayer_order)
    yield from _acquisition()
    yield from _analog()
    yield from _transport()
    if has_temperature:
        yield Feature(
            name="DeviceTemperature",
            category="DeviceControl",
            kind="float",
            address=DEVICE_PAGE + 0x300,
            description="Temperature of the main board.",
            access="RO",
            unit="C",
        )


def _image_format(bayer_order: str | None) -> Iterator[Feature]:
    whole = Feature(
        name="", category="ImageFormatControl", kind="integer", address=0, description=""
    )
    sensor = replace(whole, access="RO")
    roi = replace(whole, is_locked_while_acquiring=True, increment=2)
    page = DEVICE_PAGE
    yield replace(sensor, name="SensorWidth", address=page, description="Columns of the sensor.")
    yield replace(sensor, name="SensorHeight", address=page + 0x04, description="Its rows.")
    yield replace(sensor, name="WidthMax", address=page + 0x08, description="As SensorWidth.")
    yield replace(sensor, name="HeightMax", address=page + 0x0C, description="As SensorHeight.")
    yield replace(
        roi,
        name="Width",
        address=page + 0x10,
        minimum=16,
        maximum="WidthLimit",
        description="Columns of the region of interest.",
    )
    yield replace(
        roi,
        name="Height",
        address=page + 0x14,
        minimum=16,
        maximum="HeightLimit",
        description="Rows of the region of interest.",
    )
    yield replace(
        sensor,
        name="WidthLimit",
        address=page + 0x38,
        description="Largest Width beside the present OffsetX.",
    )
    yield replace(
        sensor,
        name="HeightLimit",
        address=page + 0x3C,
        description="Largest Height below the present OffsetY.",
    )
    yield replace(sensor, name="OffsetXMax", address=page + 0x18, description="Largest OffsetX.")
    yield replace(sensor, name="OffsetYMax", address=page + 0x1C, description="Largest OffsetY.")
    yield replace(
        roi,
        name="OffsetX",
        address=page + 0x20,
        minimum=0,
        maximum="OffsetXMax",
        description="First column of the region of interest.",
    )
    yield replace(
        roi,
        name="OffsetY",
        address=page + 0x24,
        minimum=0,
        maximum="OffsetYMax",
        description="First row of the region of interest.",
    )
    yield replace(
        whole,
        name="PixelFormat",
        kind="enumeration",
        address=page + 0x28,
        entries=tuple((name, PIXEL_LAYOUTS[name].code) for name in pixel_formats_of(bayer_order)),
        is_locked_while_acquiring=True,
        description="Format of the pixels on the wire.",
    )
    yield replace(
        sensor,
        name="PayloadSize",
        address=page + 0x2C,
        unit="B",
        description="Bytes of one image.",
    )
    for place, axis in enumerate(("Horizontal", "Vertical")):
        yield replace(
            sensor,
            name=f"Binning{axis}",
            address=page + 0x30 + 4 * place,
            minimum=1,
            maximum=1,
            description="Pixels added up; this sensor has no binning.",
        )


def _acquisition() -> Iterator[Feature]:
    page = DEVICE_PAGE + 0x100
    one = Feature(
        name="", category="AcquisitionControl", kind="enumeration", address=0, description=""
    )
    yield replace(
        one,
        name="AcquisitionMode",
        address=page,
        entries=(("Continuous", 0), ("SingleFrame", 1), ("MultiFrame", 2)),
        is_locked_while_acquiring=True,
        description="How many frames one start takes.",
    )
    yield replace(
        one,
        name="AcquisitionFrameCount",
        kind="integer",
        address=page + 0x04,
        minimum=1,
        maximum=65535,
        increment=1,
        description="Frames of one start in mode MultiFrame.",
    )
    for place, name in enumerate(("AcquisitionStart", "AcquisitionStop", "TriggerSoftware")):
        yield replace(
            one,
            name=name,
            kind="command",
            address=page + 0x08 + 4 * place,
            access="WO",
            description="Command.",
        )
    yield replace(
        one,
        name="AcquisitionActive",
        kind="integer",
        address=page + 0x14,
        access="RO",
        description="1 while frames are being taken.",
    )
    yield replace(
        one,
        name="TriggerSelector",
        address=page + 0x18,
        entries=(("FrameStart", 0),),
        description="Trigger that the next three features are about.",
    )
    yield replace(
        one,
        name="TriggerMode",
        address=page + 0x1C,
        entries=(("Off", 0), ("On", 1)),
        description="Whether frames wait for TriggerSource.",
    )
    yield replace(
        one,
        name="TriggerSource",
        address=page + 0x20,
        entries=(("Freerun", 0), ("Line1", 1), ("Line2", 2), ("FixedRate", 5), ("Software", 6)),
        description="What starts a frame; nothing is connected to the lines.",
    )
    rate = replace(one, kind="float", unit="Hz")
    yield replace(
        rate,
        name="AcquisitionFrameRateAbs",
        address=page + 0x40,
        minimum=0.01,
        maximum="AcquisitionFrameRateLimit",
        description="Frames per second.",
    )
    yield replace(
        rate,
        name="AcquisitionFrameRateLimit",
        address=page + 0x48,
        access="RO",
        description="Highest frame rate of the present settings.",
    )
    yield replace(
        one,
        name="ExposureTimeAbs",
        kind="float",
        address=page + 0x50,
        minimum=21.0,
        maximum=60_000_000.0,
        increment=1.0,
        unit="us",
        description="Exposure time.",
    )
    yield replace(
        one,
        name="ExposureAuto",
        address=page + 0x58,
        entries=(("Off", 0), ("Continuous", 1)),
        description="Whether the camera sets its exposure itself.",
    )


def _analog() -> Iterator[Feature]:
    page = DEVICE_PAGE + 0x200
    one = Feature(name="", category="AnalogControl", kind="float", address=0, description="")
    yield replace(
        one,
        name="Gain",
        address=page,
        minimum=0.0,
        maximum=31.0,
        increment=1.0,
        unit="dB",
        description="Analog gain.",
    )
    yield replace(
        one,
        name="BlackLevel",
        address=page + 0x08,
        minimum=0.0,
        maximum=255.75,
        increment=0.25,
        unit="DN",
        description="Offset in levels of 12 bits.",
    )
    yield replace(
        one,
        name="Gamma",
        address=page + 0x10,
        minimum=0.25,
        maximum=4.0,
        description="Exponent of the levels while GammaEnable is set.",
    )
    switch = replace(one, kind="boolean")
    yield replace(
        switch, name="GammaEnable", address=page + 0x18, description="Whether Gamma acts."
    )
    yield replace(
        switch,
        name="LUTEnable",
        category="LUTControl",
        address=page + 0x1C,
        description="Whether the look-up table acts; it holds the identity.",
    )
    yield replace(
        one,
        name="GainAuto",
        kind="enumeration",
        address=page + 0x20,
        entries=(("Off", 0), ("Continuous", 1)),
        description="Whether the camera sets its gain itself.",
    )


def _transport() -> Iterator[Feature]:
    register = Feature(
        name="",
        category="TransportLayerControl",
        kind="integer",
        address=0,
        description="",
    )
    part = replace(register, kind="masked", is_locked_while_acquiring=True)
    flag = replace(part, kind="flag")
    yield replace(
        part,
        name="GevSCPSPacketSize",
        address=0x0D04,
        bits=(31, 16),
        minimum=500,
        maximum=8228,
        increment=4,
        unit="B",
        description="Size of the stream's packets, IP and UDP headers included.",
    )
    yield replace(
        flag,
        name="GevSCPSDoNotFragment",
        address=0x0D04,
        bits=(1, 1),
        description="Flag that forbids fragmentation on the way.",
    )
    yield replace(
        flag,
        name="GevSCPSFireTestPacket",
        address=0x0D04,
        bits=(0, 0),
        description="Sends one packet of the set size.",
    )
    yield replace(
        part,
        name="GevSCPHostPort",
        address=0x0D00,
        bits=(31, 16),
        minimum=0,
        maximum=65535,
        is_locked_while_acquiring=False,
        description="UDP port that the stream goes to; 0 closes it.",
    )
    yield replace(
        register,
        name="GevSCDA",
        address=0x0D18,
        description="IPv4 address that the stream goes to.",
    )
    yield replace(
        register,
        name="GevSCPD",
        address=0x0D08,
        minimum=0,
        maximum=1_000_000_000,
        description="Pause between packets, in ticks of the timestamp.",
    )
    yield replace(
        register,
        name="StreamBytesPerSecond",
        address=DEVICE_PAGE + 0x280,
        minimum=1_000_000,
        maximum=124_000_000,
        increment=1,
        unit="Bps",
        description="Bandwidth that the stream may take.",
    )
    yield replace(
        register,
        name="GevHeartbeatTimeout",
        address=0x0938,
        minimum=500,
        maximum=4_000_000,
        unit="ms",
        description="Control is lost without a command for so long.",
    )
    yield replace(
        register,
        name="GevTimestampTickFrequency",
        address=0x0940,
        access="RO",
        unit="Hz",
        description="Ticks per second of the timestamp.",
    )
