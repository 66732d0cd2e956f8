"""The set's data card and licence."""

from importlib.resources import files

from hil_mocks.benchmark_set.tasks import SIZES


def card_files(size: str, seed: int) -> dict[str, bytes]:
    """README.md and LICENSE of a set, by path."""
    here = files("hil_mocks") / "benchmark_set"
    card = (here / "card.md").read_text(encoding="utf-8")
    known = SIZES[size]
    facts = {
        "size": size,
        "seed": str(seed),
        "edge_charts": str(known.edge_charts),
        "photographs": str(known.photographs),
        "simulations": str(known.simulations),
        "alignments": str(known.alignments),
        "unrelated": str(known.unrelated),
        "changes": str(known.changes),
        "scenes": str(len(known.scenes)),
        "frame": "{1} x {0}".format(*known.frame),
    }
    for name, text in facts.items():
        card = card.replace("{{" + name + "}}", text)
    licence = (here / "licence.txt").read_text(encoding="utf-8")
    return {"README.md": card.encode(), "LICENSE": licence.encode()}
