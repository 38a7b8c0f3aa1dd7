"""Logs that arrive are taken up by a command too, without any server."""

import shutil
from pathlib import Path

from typer.testing import CliRunner

from demoplan.cli.main import app

CHECKOUT = Path(__file__).resolve().parents[2]
SOURCE = CHECKOUT / "datasets" / "cube-stacking"


def test_ingest_takes_up_what_arrived_and_says_what_it_leaves(tmp_path):
    text = (SOURCE / "dataset.yaml").read_text().replace("../../schemas", f"{CHECKOUT}/schemas")
    head, _, rest = text.partition("\nepisodes:\n")
    first = ("\n" + rest).split("\n  - id: ")[1].split("\n\n")[0]
    goals = "goals:\n  - {name: one, goal: 'onTop(cube_red,cube_blue)'}\n"
    (tmp_path / "dataset.yaml").write_text(f"{head}\nepisodes:\n  - id: {first.rstrip()}\n{goals}")
    for part in ("logs", "labels"):
        shutil.copytree(SOURCE / part, tmp_path / part)
    for path in (tmp_path / "logs").glob("p[23]*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    shutil.copy(tmp_path / "logs" / "p1-one-left.mcap", tmp_path / "logs" / "other.mcap")
    arguments = ["ingest", str(tmp_path), "--store", str(tmp_path / "store"), "--workers", "1", "--json"]
    taken = CliRunner().invoke(
        app, [*arguments, "--take-up", "(?P<participant>p1)-(?P<task>.+)", "--quiet", "0"]
    )
    assert taken.exit_code == 0, taken.output
    assert "p1-two-right" in taken.stdout
    assert "other.mcap is left alone: its name does not fit" in taken.stderr
    assert "- id: p1-two-right" in (tmp_path / "dataset.yaml").read_text()
