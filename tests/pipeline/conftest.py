"""A small dataset for tests of whole runs."""

from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def small_dataset(tmp_path_factory):
    """Three shipped episodes, one of each log format, as a dataset of their own; and where its logs are."""
    folder = tmp_path_factory.mktemp("small")
    root = CHECKOUT / "datasets/cube-stacking"
    head, _, rest = (root / "dataset.yaml").read_text().partition("\nepisodes:\n")
    wanted = ("p1-one-left", "p2-one-right", "p3-one-left")
    blocks = [b for b in ("\n" + rest).split("\n  - id: ")[1:] if b.split("\n")[0] in wanted]
    assert len(blocks) == len(wanted)
    entries = [
        "\n".join([b.split("\n")[0], *[x for x in b.split("\n")[1:] if x[:4] == "    "]]) for b in blocks
    ]
    text = head.replace("../../schemas", f"{CHECKOUT}/schemas").replace(
        "name: cube-stacking", "name: small", 1
    )
    text += "\nepisodes:\n" + "".join(f"  - id: {entry}\n" for entry in entries)
    text += "goals:\n  - {name: one, goal: 'onTop(cube_red,cube_blue)'}\n"
    (folder / "dataset.yaml").write_text(text)
    return folder, root
