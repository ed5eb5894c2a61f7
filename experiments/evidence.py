"""Tables over saved runs: which couplings of a hidden tilt were found, with what sign and t.

python -m experiments.evidence runs/noise [--by strategy record.noise_level ...] [--json FILE]

Reads the ``run.json`` of every run in a folder, as a sweep (``-m``) left them, groups them by
their options, and counts over the records' seeds.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

# Leading-order projection of the tilting rotor, per unit mass (library=projection gives it).
TRUTH = {
    "cross_stiffness.stiffness": 1105.4,
    "cubic_stiffness.stiffness": 3.3934e10,
    "gyroscopic.coefficient": 4.802e-3,
}
SECOND_ORDER = ("cross_damping", "speed_stiffness")
"""True beyond leading order, so no false terms where a tilt is hidden."""
SEED = ("linear_stiffness", "linear_damping", "unbalance")
_PAPERS = (
    "ljung_box", "bonferroni_t", "correlation_cluster", "contribution", "kfold_majority",
    "partial_f", "validation_rollback",
)  # fmt: skip


def row(data: dict[str, Any]) -> dict[str, Any]:
    """One saved run as the figures that the tables need."""
    config, result = data["config"], data["result"]
    rounds = result["rounds"]
    table = rounds[-1]["details"].get("coefficients", {})
    hidden = config["experiment"] != "rotor_nothing_hidden"
    true = {k.split(".")[0] for k in TRUTH} | set(SECOND_ORDER) if hidden else set()
    found = {k: e for k, p in _terms(result).items() for e in [p] if e["estimate"] != 0.0}
    false = [k for k in found if k.split(".")[0] not in true | set(SEED)]
    couplings, strategy = {}, config["strategy"]
    if isinstance(strategy, str):  # a run of before strategies had options
        strategy = {"name": strategy, **config.get("paper", {})}
    for key, truth in TRUTH.items():
        if key in found:
            robust = table.get(key, {}).get("t_hac", found[key]["t"])
            couplings[key] = {
                "ratio": found[key]["estimate"] / truth,
                "t_ols": table.get(key, {}).get("t_ols"),
                "t": robust,
            }
    return {
        "experiment": config["experiment"],
        "strategy": strategy["name"],
        "library": config["library"]["name"],
        "derivative": config["derivative"]["name"],
        "learner": config["learner"]["name"],
        "sampling": strategy.get("sampling", ""),
        "gates": gates_told(list(config["gate"])),
        "noise": config["record"]["noise_level"],
        "seed": config["record"]["seed"],
        "couplings": couplings,
        "false": false,
        "rounds": len(rounds) - 1,
        "ended": rounds[-1]["details"].get("ended", {}).get("reason", result["stopped"]),
        "seed_error": rounds[0]["test_error"],
        "test_error": rounds[-1]["test_error"],
        "noise_floor": result["noise_floor"],
        "seconds": sum(r["seconds"] for r in rounds),
        "pass_rate": rounds[0]["details"].get("bonferroni_t", {}).get("pass_rate"),
    }


def _terms(result: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Fitted amplitudes by full name."""
    return {
        f"{owner}.{name}": estimate
        for owner, parameters in result["model"]["effects"].items()
        for name, estimate in parameters.items()
        if estimate["se"] is not None
    }


def gates_told(names: Sequence[str]) -> str:
    """A list of gates by what it lacks of the paper's, or adds."""
    if not names:
        return "none"
    lacking = [n for n in _PAPERS if n not in names]
    more = [n for n in names if n not in _PAPERS]
    told = [f"without {', '.join(lacking)}"] if lacking else []
    told += [f"with {', '.join(more)}"] if more else []
    return "; ".join(told) or "the paper's"


def load(folder: Path) -> list[dict[str, Any]]:
    """Every saved run of a folder, oldest first; a later run of the same question replaces one."""
    rows: dict[str, dict[str, Any]] = {}
    for file in sorted(folder.glob("*/run.json")):
        found = row(json.loads(file.read_text(encoding="utf-8")))
        keys = ("experiment", "strategy", "library", "derivative", "learner", "sampling", "gates",
                "noise", "seed")  # fmt: skip
        rows[repr([found[k] for k in keys])] = found
    return list(rows.values())


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts and medians over the seeds of one group."""
    found: dict[str, Any] = {"runs": len(rows)}
    for key in TRUTH:
        hits = [r["couplings"][key] for r in rows if key in r["couplings"]]
        found[key.split(".")[0]] = {
            "found": len(hits),
            "right_sign": sum(h["ratio"] > 0 for h in hits),
            "within_20_percent": sum(abs(h["ratio"] - 1) < 0.2 for h in hits),
            "ratio": _median([h["ratio"] for h in hits]),
            "t_ols": _median([h["t_ols"] for h in hits if h["t_ols"] is not None]),
            "t": _median([h["t"] for h in hits if h["t"] is not None]),
        }
    found["false"] = float(np.mean([len(r["false"]) for r in rows]))
    found["runs_with_false"] = sum(bool(r["false"]) for r in rows)
    errors = [r["test_error"] if r["test_error"] is not None else np.inf for r in rows]
    found["test_error"] = float(np.median(errors))
    found["seconds"] = _median([r["seconds"] for r in rows])
    return found


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def table(rows: list[dict[str, Any]], by: Sequence[str]) -> list[str]:
    """The groups as lines of a Markdown table."""
    groups: dict[tuple, list[dict[str, Any]]] = {}
    for one in rows:
        groups.setdefault(tuple(one[b] for b in by), []).append(one)
    names = [k.split(".")[0] for k in TRUTH]
    head = [*by, "runs", *names, "false terms", "test error", "s"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for values, members in sorted(groups.items(), key=lambda g: repr(g[0])):
        s = summary(members)
        cells = [_told(v) for v in values]
        cells += [str(s["runs"]), *(_coupling(s[n], s["runs"]) for n in names)]
        cells += [f"{s['false']:.1f}", _percent(s["test_error"]), f"{s['seconds']:.0f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _told(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _coupling(found: dict[str, Any], runs: int) -> str:
    if not found["found"]:
        return f"0/{runs}"
    plain = f" {found['t_ols']:.3g} /" if found["t_ols"] is not None else ""
    signs = f"{found['found']}/{runs}, sign right {found['right_sign']}"
    return f"{signs}; x{found['ratio']:.3g}; t{plain} {found['t']:.3g}"


def _percent(value: float) -> str:
    return "diverges" if not np.isfinite(value) else f"{100 * value:.3g} %"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", help="folder of saved runs (out=)")
    parser.add_argument("--by", nargs="*", default=["experiment", "strategy", "library", "noise"])
    parser.add_argument("--json", help="file for one row per run")
    given = parser.parse_args()
    rows = load(Path(given.folder))
    print("\n".join(table(rows, given.by)))
    print(
        "\ncoupling: runs that admit it, with the right sign; median estimate over the projected "
        "truth; median |t| with OLS / HAC errors (shooting: its own)"
    )
    if given.json:
        Path(given.json).write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
