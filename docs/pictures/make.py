"""Draw the pictures that the README shows, from a run of the demo: ``make pictures``."""

import tempfile
from pathlib import Path

from spiral.cli import main
from spiral.curves import read_curves
from spiral.report.page import figures, single
from spiral.report.pictures import picture
from spiral.storage import load_run

SHOWN = ("error_falling", "where", "surface")


def draw(target: Path) -> None:
    with tempfile.TemporaryDirectory() as out:
        study = ("discover", "experiment=rotor_coastdown", "tracking.enabled=false", f"out={out}")
        if main([*study]) != 0:
            raise SystemExit("the demo failed")
        saved = load_run("latest", out)
        for shown in figures(saved.data, read_curves(saved.file.parent)):
            if shown.name in SHOWN:
                height = int(shown.figure.layout.height) + 4
                print(picture(single(shown), target / f"{shown.name}.png", 1060, height))


if __name__ == "__main__":
    draw(Path(__file__).parent)
