import pytest

from acquisition.aravis.description import require_sound_description
from acquisition.aravis.description.checking import LONGEST_REGISTER_BYTES
from acquisition.errors import CameraDescriptionError
from hil_mocks.gige.description import describe
from hil_mocks.gige.features import MAKERS, Maker, features_of
from hil_mocks.gige.registers import maker_identity
from tests.acquisition.aravis.description_texts import description, node


@pytest.mark.parametrize("maker", MAKERS)
def test_the_simulated_cameras_of_all_makers_are_sound(maker: Maker) -> None:
    identity = maker_identity(maker)
    features = features_of(None, has_temperature=True, maker=maker)
    text = describe(features, vendor=identity.vendor, model=identity.model)
    sound = require_sound_description(text, "the camera")
    assert sound.nodes_of("Width") == ("Width", "WidthReg")


def register(kind: str, length: str) -> bytes:
    return description(
        node("Integer", "N", "<Value>4</Value>"),
        node(kind, "A", f"<Address>0xa010</Address>{length}<pPort>Device</pPort>"),
    )


@pytest.mark.parametrize("length", ["-1", "0", "", "four", "0x7fffffffffffffff", "1048577", "1e99"])
@pytest.mark.parametrize("kind", ["IntReg", "MaskedIntReg", "FloatReg", "StringReg", "StructReg"])
def test_a_register_of_an_impossible_length_is_refused(kind: str, length: str) -> None:
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(register(kind, f"<Length>{length}</Length>"), "the camera")
    assert (refused.value.fault, refused.value.nodes) == ("register", ("A",))


@pytest.mark.parametrize("length", ["", "<Length>4</Length>", "<Length>0x8</Length>"])
def test_registers_of_usual_lengths_are_sound(length: str) -> None:
    require_sound_description(register("IntReg", length), "the camera")
    most = f"<Length>{LONGEST_REGISTER_BYTES}</Length>"
    require_sound_description(register("Register", most), "the camera")


def test_only_texts_and_raw_registers_may_leave_their_length_to_another_node() -> None:
    for kind in ("IntReg", "MaskedIntReg", "FloatReg", "StructReg"):
        with pytest.raises(CameraDescriptionError):
            require_sound_description(register(kind, "<pLength>N</pLength>"), "the camera")
    sound = require_sound_description(register("StringReg", "<pLength>N</pLength>"), "the camera")
    assert sound.of_open_length == {"A"}
    assert set(sound.nodes_of("A")) == {"A", "N"}


def test_registers_in_chunks_are_known_by_their_port() -> None:
    chunk = description(
        '<Port Name="ChunkPort"><ChunkID>12</ChunkID></Port>',
        node("IntReg", "C", "<Address>0</Address><Length>4</Length><pPort>ChunkPort</pPort>"),
        node("Integer", "A", "<pValue>C</pValue>"),
    )
    sound = require_sound_description(chunk, "the camera")
    assert sound.in_chunks == {"C"}


def test_two_nodes_of_one_name_and_different_kinds_are_refused() -> None:
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(description(node("Float", "R", "<Value>1</Value>")), "it")
    assert refused.value.nodes == ("R",)


def test_names_with_escape_bytes_come_out_printable() -> None:
    odd = description(node("Integer", "A&#x9b;31m", "<pValue>A&#x9b;31m</pValue>"))
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(odd, "the camera")
    assert str(refused.value).isprintable()
