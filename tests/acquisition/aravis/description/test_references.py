from itertools import pairwise

import pytest
from hypothesis import example, given, strategies as st

from acquisition.aravis.description import (
    LONGEST_CHAIN,
    MOST_EVALUATIONS,
    Node,
    Property,
    parse_nodes,
    require_sound_description,
)
from acquisition.errors import CameraDescriptionError
from tests.acquisition.aravis.description_texts import (
    CIRCLES,
    HARMLESS,
    description,
    graph_of,
    in_a_row,
    node,
)

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
    nodes = parse_nodes(description(split, node("Integer", "R2", "<Value>1</Value>")))
    assert nodes["A"] == Node(
        name="A", kind="Integer", properties=[Property(tag="pValue", attributes={}, text="R2")]
    )
