"""Descriptions of cameras: their nodes, what refers to what, and what is refused."""

from contextlib import suppress
from itertools import pairwise

import pytest
from hypothesis import example, given, strategies as st

from acquisition.aravis._description import (
    DEEPEST_ELEMENT,
    LARGEST_BYTES,
    LONGEST_CHAIN,
    LONGEST_REGISTER_BYTES,
    MOST_ELEMENTS,
    MOST_EVALUATIONS,
    DescriptionError,
    _Node,
    _parse_nodes,
    _Property,
    require_sound_description,
)
from acquisition.errors import CameraDescriptionError
from hil_mocks.gige import Maker, maker_identity
from hil_mocks.gige._description import describe
from hil_mocks.gige._features import MAKERS, features_of
from tests.acquisition.aravis.description_texts import (
    CIRCLES,
    HARMLESS,
    HEAD,
    TAIL,
    description,
    graph_of,
    in_a_row,
    node,
    simulated,
)


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


def refusal(data: bytes) -> DescriptionError:
    with pytest.raises(DescriptionError) as refused:
        _parse_nodes(data)
    return refused.value


def test_the_nodes_of_the_simulated_camera_are_all_there() -> None:
    nodes = _parse_nodes(simulated())
    assert nodes["Width"].kind == "Integer"
    assert [*nodes["Width"].texts("pValue")] == ["WidthReg"]
    assert [*nodes["WidthReg"].texts("Length")] == ["4"]
    assert nodes["TriggerMode"].evaluated_with == ["TriggerMode.Off", "TriggerMode.On"]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no description",
        HEAD.encode(),
        f"{HEAD}<Integer></Float>{TAIL}".encode(),
        f"{HEAD}<Integer Name='A' Name='B'/>{TAIL}".encode(),
        f"{HEAD}&undefined;{TAIL}".encode(),
        f"{HEAD}{TAIL}{HEAD}{TAIL}".encode(),
        b"<html><body>404</body></html>",
        description(node("Integer", "A", "<Value>\xff</Value>")).replace(b"\xc3", b""),
        description().replace(b"utf-8", b"utf-7"),
        description().replace(b"utf-8", b"no-such-encoding"),
        description().decode().encode("utf-16"),
    ],
)
def test_what_is_no_well_formed_description_is_refused(data: bytes) -> None:
    assert refusal(data).fault == "not XML"


@pytest.mark.parametrize(
    "doctype",
    [
        "<!DOCTYPE RegisterDescription>",
        '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>',
        '<!DOCTYPE r SYSTEM "file:///etc/passwd">',
    ],
)
def test_a_document_type_is_refused_before_anything_in_it_is_expanded(doctype: str) -> None:
    data = description(node("String", "A", "<Value>&b;</Value>"))
    refused = refusal(
        data.replace(b"<RegisterDescription", doctype.encode() + b"<RegisterDescription", 1)
    )
    assert "document type" in str(refused)


@pytest.mark.slow
def test_what_is_larger_or_deeper_than_any_camera_is_refused() -> None:
    deep = "<Group>" * DEEPEST_ELEMENT + "</Group>" * DEEPEST_ELEMENT
    for data in (
        description(" " * LARGEST_BYTES),
        description(deep),
        description("<a/>" * MOST_ELEMENTS),
        description(node("Integer", "A" * 2000, "")),
    ):
        assert refusal(data).fault == "too large"


@pytest.mark.parametrize("encoding", ["iso-8859-1", "windows-1252", "gb2312", "utf-8"])
def test_descriptions_in_other_encodings_are_read(encoding: str) -> None:
    text = description(node("String", "A", "<Value>25 °C</Value>")).decode("utf-8")
    data = text.replace("utf-8", encoding).encode(encoding)
    assert [*_parse_nodes(data)["A"].texts("Value")] == ["25 °C"]


def test_zero_bytes_after_the_end_and_a_mark_before_the_begin_are_no_damage() -> None:
    assert "R" in _parse_nodes(b"\xef\xbb\xbf" + description() + b"\n\0\0\0\xff")


def test_what_aravis_skips_is_skipped() -> None:
    odd = "<Extension><Integer Name='A'><pValue>A</pValue></Integer></Extension>"
    assert "A" not in _parse_nodes(description(odd))


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    for text in (data, HEAD.encode() + data + TAIL.encode()):
        with suppress(DescriptionError):
            _parse_nodes(text)


NAMES = tuple("ABCDEFGH")

GRAPHS = st.dictionaries(
    st.sampled_from(NAMES), st.lists(st.sampled_from(NAMES), max_size=4), min_size=1
).map(lambda found: {name: [o for o in others if o in found] for name, others in found.items()})


def reached_from(graph: dict[str, list[str]], start: str) -> set[str]:
    """All nodes that a node leads to in one step or more, step by step until none is new."""
    reached: set[str] = set(graph[start])
    for _ in graph:
        reached |= {other for name in reached for other in graph[name]}
    return reached


@pytest.mark.slow
@given(GRAPHS)
@example({"A": ["A"]})
@example({"A": ["B", "C"], "B": ["D"], "C": ["D"], "D": []})
@example({"A": [], "B": ["C"], "C": ["D"], "D": ["B", "A"]})
def test_a_circle_is_found_exactly_where_a_node_leads_back_to_itself(
    graph: dict[str, list[str]],
) -> None:
    has_circle = any(name in reached_from(graph, name) for name in graph)
    if not has_circle:
        require_sound_description(graph_of(graph), "the camera")
        return
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(graph_of(graph), "the camera")
    around = refused.value.nodes
    assert refused.value.fault == "circle"
    assert around[0] == around[-1]
    assert all(after in graph[before] for before, after in pairwise(around))


@pytest.mark.parametrize("length", [1, 2, 3, 40])
@pytest.mark.parametrize("kind", CIRCLES)
def test_every_reference_that_a_value_is_evaluated_through_can_close_a_circle(
    kind: str, length: int
) -> None:
    names = [f"N{place}" for place in range(length)]
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(
            description(in_a_row(*CIRCLES[kind], names)), "the camera at 10.0.0.7"
        )
    assert refused.value.fault == "circle"
    named = [name for name in refused.value.nodes if name in names]
    assert set(named) == set(names)
    assert "10.0.0.7" in str(refused.value)
    assert len(str(refused.value)) < 600
    assert str(refused.value).isprintable()


@pytest.mark.parametrize("kind", HARMLESS)
def test_references_beside_the_value_may_lead_back(kind: str) -> None:
    for names in (["A"], ["A", "B"]):
        require_sound_description(description(in_a_row(*HARMLESS[kind], names)), "the camera")


def test_a_width_and_an_offset_that_limit_each_other_are_no_circle() -> None:
    rest = '<pVariable Name="V">{other}</pVariable><Formula>780 - V</Formula>'
    require_sound_description(
        description(
            node("Integer", "Width", "<pValue>R</pValue><pMax>WidthMost</pMax>"),
            node("Integer", "OffsetX", "<pValue>R</pValue><pMax>OffsetXMost</pMax>"),
            node("IntSwissKnife", "WidthMost", rest.format(other="OffsetX")),
            node("IntSwissKnife", "OffsetXMost", rest.format(other="Width")),
        ),
        "the camera",
    )


def test_an_entry_of_a_structure_needs_the_structure() -> None:
    structure = (
        '<StructReg Name="S"><pAddress>E</pAddress><Length>4</Length><pPort>Device</pPort>'
        '<StructEntry Name="E"><LSB>0</LSB><MSB>3</MSB></StructEntry></StructReg>'
    )
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(description(structure), "the camera")
    assert set(refused.value.nodes) == {"S", "E"}


def test_a_chain_is_refused_where_it_grows_longer_than_any_cameras() -> None:
    def chain(length: int) -> bytes:
        names = [f"N{place}" for place in range(length)]
        graph = {name: [after] for name, after in pairwise(names)}
        return graph_of({**graph, names[-1]: []})

    require_sound_description(chain(LONGEST_CHAIN), "the camera")
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(chain(LONGEST_CHAIN + 1), "the camera")
    assert refused.value.fault == "too large"
    assert refused.value.nodes == ("N0",)


def test_a_short_description_that_asks_for_billions_of_evaluations_is_refused() -> None:
    def twice(levels: int) -> bytes:
        names = [f"N{place}" for place in range(levels)]
        graph = {name: [after, after] for name, after in pairwise(names)}
        return graph_of({**graph, names[-1]: []})

    # 2^n - 1 nodes are evaluated for one of n levels.
    most = MOST_EVALUATIONS.bit_length() - 1
    require_sound_description(twice(most), "the camera")
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(twice(40), "the camera")
    assert refused.value.fault == "too large"


@pytest.mark.parametrize("tag", ["pValue", "pMax", "pMin", "pInc"])
def test_a_node_that_does_not_exist_is_named_with_the_one_that_needs_it(tag: str) -> None:
    missing = node("Integer", "A", f"<pValue>R</pValue><{tag}>Nowhere</{tag}>")
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(description(missing), "the camera")
    assert refused.value.fault == "missing node"
    assert refused.value.nodes == ("A", "Nowhere")


@pytest.mark.parametrize("tag", ["pSelected", "pInvalidator", "pIsAvailable", "pFeature"])
def test_a_missing_node_that_no_value_comes_from_is_none_of_ours(tag: str) -> None:
    missing = node("Integer", "A", f"<pValue>R</pValue><{tag}>Nowhere</{tag}>")
    require_sound_description(description(missing), "the camera")


def test_nodes_that_aravis_adds_may_be_referred_to_but_not_be_replaced() -> None:
    require_sound_description(
        description(node("Integer", "A", "<pValue>GevSCPSPacketSize</pValue>")), "the camera"
    )
    # GevSCPSPacketSize, which Aravis adds, refers to this one.
    closed = node("Integer", "ArvGevSCPSPacketSizeReg", "<pValue>GevSCPSPacketSize</pValue>")
    with pytest.raises(CameraDescriptionError) as refused:
        require_sound_description(description(closed), "the camera")
    assert refused.value.fault == "node"


def test_names_are_compared_without_blanks_and_split_texts_are_joined() -> None:
    split = '<Integer Name=" A "><pValue> <!-- a remark -->R<![CDATA[2]]><Odd/> </pValue></Integer>'
    nodes = _parse_nodes(description(split, node("Integer", "R2", "<Value>1</Value>")))
    assert nodes["A"] == _Node(
        name="A", kind="Integer", properties=[_Property(tag="pValue", attributes={}, text="R2")]
    )
