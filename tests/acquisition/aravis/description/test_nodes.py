from contextlib import suppress

import pytest
from hypothesis import given, strategies as st

from acquisition.aravis.description import (
    DEEPEST_ELEMENT,
    LARGEST_BYTES,
    MOST_ELEMENTS,
    DescriptionError,
    parse_nodes,
)
from tests.acquisition.aravis.description_texts import HEAD, TAIL, description, node, simulated


def refusal(data: bytes) -> DescriptionError:
    with pytest.raises(DescriptionError) as refused:
        parse_nodes(data)
    return refused.value


def test_the_nodes_of_the_simulated_camera_are_all_there() -> None:
    nodes = parse_nodes(simulated())
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
    assert [*parse_nodes(data)["A"].texts("Value")] == ["25 °C"]


def test_zero_bytes_after_the_end_and_a_mark_before_the_begin_are_no_damage() -> None:
    assert "R" in parse_nodes(b"\xef\xbb\xbf" + description() + b"\n\0\0\0\xff")


def test_what_aravis_skips_is_skipped() -> None:
    odd = "<Extension><Integer Name='A'><pValue>A</pValue></Integer></Extension>"
    assert "A" not in parse_nodes(description(odd))


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    for text in (data, HEAD.encode() + data + TAIL.encode()):
        with suppress(DescriptionError):
            parse_nodes(text)
