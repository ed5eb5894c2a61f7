"""Structures by their matrices: a finite-element beam, clamped at one end."""

import json

import numpy as np
import pytest
from scipy import sparse
from scipy.integrate import solve_ivp
from scipy.io import hb_write, mmwrite, savemat
from scipy.linalg import eigh

import spiral
from spiral.engine.series import steps_per_sample
from spiral.inference.simulate import simulate
from spiral.io.config import build_system, compose
from spiral.io.readers import containers
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.storage import model_data, rebuild_model
from spiral.io.testing import check_system, failed
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.errors import InputError, SpiralError
from spiral.types.model import seed_model
from spiral.types.record import make_record

ELEMENTS = 150
STIFFNESS = 3e5  # N/m^3 of the hidden spring


def beam():
    """M and K of Euler and Bernoulli's aluminium beam, 1 m, 30 mm x 4 mm: deflections, slopes."""
    length, area, inertia = 1.0 / ELEMENTS, 0.03 * 0.004, 0.03 * 0.004**3 / 12
    a, b = 6 * length, 2 * length**2
    k = [[12, a, -12, a], [a, 2 * b, -a, b], [-12, -a, 12, -a], [a, b, -a, 2 * b]]
    c, d, f = 22 * length, 13 * length, length**2
    m = [[156, c, 54, -d], [c, 4 * f, d, -3 * f], [54, d, 156, -c], [-d, -3 * f, -c, 4 * f]]
    k = 7e10 * inertia / length**3 * np.array(k)
    m = 2700 * area * length / 420 * np.array(m)
    mass, stiffness = np.zeros((2, 2 * ELEMENTS + 2, 2 * ELEMENTS + 2))
    for e in range(ELEMENTS):
        at = slice(2 * e, 2 * e + 4)
        mass[at, at] += m
        stiffness[at, at] += k
    return mass[2:, 2:], stiffness[2:, 2:]


def row(place):
    """The deflection at a share of the length."""
    return 2 * (round(ELEMENTS * place) - 1)


NODES = {
    "drive": {"dof": row(0.2), "use": "input port"},
    "middle": {"dof": row(0.5), "use": "sensor port"},
    "tip": {"dof": row(1.0), "use": "sensor port"},
}


@pytest.fixture(scope="module")
def full():
    return dict(zip("MK", beam(), strict=True))


@pytest.fixture(scope="module")
def small(full):
    return spiral.structure(full, NODES, size=8, band=(0, 60), pairs={"link": ("middle", "tip")})


def slopes(system, values=None):
    """f_x of the compiled system at rest, and f_u by its inputs."""
    traced = trace(system, ())
    n, count = len(traced.x), len(traced.p)
    pairs = zip(traced.keys, traced.parameters, strict=True)
    p = np.array([(values or {}).get(k, q.start) for k, q in pairs])
    found = []
    for unit in (np.zeros(len(traced.u)), *np.eye(len(traced.u))):
        f, by_x = np.zeros(n), np.zeros((n, n))
        compile_model(traced).rate(np.zeros(n), unit, p, f, by_x, np.zeros((n, count)))
        found.append(f)
    return by_x, np.array(found[1:]).T


def test_static_response_is_exact_and_the_rest_converges(full, small):
    """Constraint modes hold the static deflection; more coordinates, less error in the band."""
    by_x, by_u = slopes(small)
    rows = [NODES[n]["dof"] for n in small.form.names[:3]]
    load = np.zeros(len(full["K"]))
    load[NODES["drive"]["dof"]] = 1.0
    moved = -np.linalg.solve(by_x, by_u[:, 0])[:3]
    assert moved == pytest.approx(np.linalg.solve(full["K"], load)[rows], rel=1e-6)
    told = [
        json.loads(spiral.structure(full, NODES, size=n, band=(0, 60)).text) for n in (5, 8, 12)
    ]
    errors = [t["response_error"] for t in told]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]
    true = np.sqrt(eigh(full["K"], full["M"], eigvals_only=True)[:3]) / (2 * np.pi)
    form = small.form
    found = np.sqrt(eigh(form.stiffness, form.mass, eigvals_only=True)[:3]) / (2 * np.pi)
    assert max(found / true - 1) == pytest.approx(told[1]["frequency_error"], rel=1e-3)
    assert told[1]["frequency_error"] < 1e-3
    assert "300 degrees of freedom reduced to 8" in small.report


def test_every_mode_has_the_damping_ratio_and_parts_their_factors(full):
    """Poles of the compiled system: -z w +- i w sqrt(1 - z^2); and after a part has changed."""
    joint = np.zeros_like(full["K"])
    joint[row(0.5), row(0.5)] = 400.0
    split = {**full, "K_joint": joint}
    system = spiral.structure(split, NODES, size=8, band=(0, 60), damping_ratio=0.03)
    poles = np.linalg.eigvals(slopes(system)[0])
    assert -poles.real / np.abs(poles) == pytest.approx(np.full(16, 0.03), rel=1e-6)
    assert {p.name for p in system.parameters} == {"stiffness", "damping_ratio", "joint"}
    softer = np.linalg.eigvals(slopes(system, {"system.joint": 0.2, "system.stiffness": 1.1})[0])
    again = np.sqrt(eigh(1.1 * full["K"] + 0.2 * joint, full["M"], eigvals_only=True)[:2])
    assert np.sort(np.abs(softer))[[0, 2]] == pytest.approx(again, rel=2e-3)


def test_a_turning_structure_has_its_gyroscopic_forces():
    """Two planes coupled by speed: whirl at w = +-W g / 2 + sqrt(k + (W g / 2)^2)."""
    matrices = {"M": np.eye(2), "K": 100 * np.eye(2), "G": np.array([[0, 0.5], [-0.5, 0]])}
    nodes = {"x": {"dof": 0, "use": "sensor"}, "y": {"dof": 1, "use": "sensor"}}
    system = spiral.structure(matrices, nodes, size=2, band=(0, 3), damping_ratio=0.0)
    assert not failed(check_system(system))
    traced = trace(system, ())
    by_x = np.zeros((4, 4))
    inputs = np.array([8.0 if n == "speed" else 0.0 for n in traced.inputs])
    compile_model(traced).rate(
        np.zeros(4), inputs, np.array([1.0, 0.0]), np.zeros(4), by_x, np.zeros((4, 2))
    )
    found = np.sort(np.abs(np.linalg.eigvals(by_x).imag))[[0, 2]]
    assert found == pytest.approx([-2 + np.sqrt(104), 2 + np.sqrt(104)])


def test_files_of_all_kinds_give_one_structure(full, small, tmp_path):
    """NPZ on the command line, MAT, Matrix Market, Harwell-Boeing; a saved run without them."""
    np.savez(tmp_path / "beam.npz", **full)
    savemat(tmp_path / "beam.mat", full)
    mmwrite(tmp_path / "m.mtx", sparse.csc_matrix(full["M"]))
    hb_write(tmp_path / "k.hb", sparse.csc_matrix(full["K"]))
    rows = [f"{n},{v['dof']},{v['use']}" for n, v in NODES.items()]
    nodes = tmp_path / "nodes.csv"
    nodes.write_text("\n".join(["name,dof,use", *rows]), encoding="utf-8")
    registry = load_registry(NO_FOLDER)
    chosen = [f"system={tmp_path / 'beam.npz'}", f"system.nodes={nodes}", "system.size=8"]
    chosen += ["system.band=[0,60]", "system.pairs={link: [middle, tip]}"]
    system = build_system(compose(chosen, registry), registry)
    assert system.text == small.text
    assert [p.name for p in system.ports] == ["drive", "middle", "tip", "link"]
    assert not failed(check_system(system))
    for source in (tmp_path / "beam.mat", {"M": tmp_path / "m.mtx", "K": str(tmp_path / "k.hb")}):
        other = spiral.structure(source, nodes, size=8, band=(0, 60))
        assert other.form.stiffness == pytest.approx(system.form.stiffness, rel=1e-6)
    saved = json.loads(json.dumps(model_data(seed_model(system))))
    (tmp_path / "beam.npz").unlink()
    assert rebuild_model(saved, registry).system == system


@pytest.mark.parametrize(
    ("changed", "options", "said"),
    [
        ({"K": None}, {}, ["no K here", "numpy.savez"]),
        ({"M": np.eye(3)}, {}, ["300 x 300", "3 x 3"]),
        ({"C": np.triu(np.ones((300, 300)))}, {}, ["C, of which", "C = C^T"]),
        ({}, {"size": 2}, ["size=2", "3 to 300"]),
        ({}, {"pairs": {"link": ["middle", "top"]}}, ["pair link: 'top'", "did you mean 'tip'"]),
        ({}, {"band": (50, 10)}, ["the low and the high frequency"]),
        ({}, {"nodes": {"tip": {"dof": 300}}}, ["a row from 0 to 299"]),
        ({}, {"nodes": {"tip": {"dof": 3, "use": "sensors"}}}, ["did you mean 'sensor'"]),
        ({}, {"nodes": {"tip": {"dof": 3, "use": "port"}}}, ["without a sensor"]),
    ],
)
def test_what_does_not_fit_is_refused(full, changed, options, said):
    given = {k: v for k, v in {**full, **changed}.items() if v is not None}
    with pytest.raises(SpiralError) as caught:
        spiral.structure(given, **{"nodes": NODES, "size": 8, "band": (0, 60), **options})
    for words in said:
        assert words in str(caught.value)


@pytest.mark.slow
def test_a_hidden_spring_is_found_at_its_node(full, small):
    """The full beam's first 15 modes with a cubic spring at the middle make the record."""
    values, modes = eigh(full["K"], full["M"], subset_by_index=(0, 14))
    omega, (drive, middle, tip) = np.sqrt(values), (modes[NODES[n]["dof"]] for n in NODES)
    time = np.arange(1500) / 600
    lines = np.arange(1, 126)[:, None] * 0.4
    turns = np.random.default_rng(5).random(lines.shape)
    force = 4 * np.sqrt(2 / 125) * np.sin(2 * np.pi * (lines * time + turns)).sum(axis=0)

    def rate(t, x):
        eta, speed = np.split(x, 2)
        push = 4 * np.sqrt(2 / 125) * np.sin(2 * np.pi * (lines * t + turns)).sum()
        spring = STIFFNESS * (middle @ eta) ** 3
        pull = omega**2 * eta + 0.02 * omega * speed
        return np.concatenate([speed, drive * push - middle * spring - pull])

    motion = solve_ivp(rate, (0, time[-1]), np.zeros(30), t_eval=time, rtol=1e-7, atol=1e-9).y[:15]
    rng = np.random.default_rng(6)
    channels = {n: phi @ motion for n, phi in (("middle", middle), ("tip", tip))}
    channels = {n: y + 0.01 * y.std() * rng.normal(size=y.size) for n, y in channels.items()}
    record = make_record(small, "beam", time, channels, {"force_drive": force})
    asked = [f"cubic_stiffness{port}" for port in ("", "@middle", "@tip", "@link")]
    run = spiral.discover(record, small, candidates=asked, free=["system.damping_ratio"])
    assert run.missing == ("cubic_stiffness@middle",)
    found = run.model.values["cubic_stiffness@middle.stiffness"]
    assert found == pytest.approx(STIFFNESS, rel=0.05)
    print(small.report, found, run, sep="\n")


def test_a_file_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    """By what its table of contents declares, as files of records are."""
    monkeypatch.setattr(containers, "UNPACKED", 1000)
    np.savez_compressed(tmp_path / "large.npz", M=np.eye(200), K=np.eye(200))
    with pytest.raises(InputError, match="unpack"):
        spiral.structure(tmp_path / "large.npz", {"a": 0}, size=1, band=(0, 1))


def test_higher_modes_are_lowered_by_mass(full):
    """Those below stay, the others come to ``highest``; statics is as it was, the band nearly."""
    told = {h: spiral.structure(full, NODES, size=8, band=(0, 60), highest=h) for h in (240, 1e9)}
    lowered, plain = (told[h].form for h in (240, 1e9))
    below = [np.sqrt(eigh(f.stiffness, f.mass, eigvals_only=True)) / (2 * np.pi)
             for f in (lowered, plain)]  # fmt: skip
    count = int(np.sum(below[1] < 240))
    assert 0 < count < 8
    assert below[0][:count] == pytest.approx(below[1][:count], rel=1e-6)
    assert below[0][count:] == pytest.approx(240, rel=1e-6)
    nodes = [np.linalg.inv(f.stiffness)[:3, :3] for f in (lowered, plain)]
    assert nodes[0] == pytest.approx(nodes[1], rel=1e-6)
    errors = [json.loads(told[h].text)["response_error"] for h in (240, 1e9)]
    assert errors[0] < 1.5 * errors[1]
    assert "modes above it were lowered" in told[240].report
    with pytest.raises(SpiralError, match="below the end of the band"):
        spiral.structure(full, NODES, size=8, band=(0, 60), highest=50)


def test_every_mode_moves_by_itself(full):
    """Of the equations of 8 coordinates those of the 3 nodes alone are full; an end is no port."""
    nodes = {**NODES, "middle": {**NODES["middle"], "use": "sensor end"}}
    system = spiral.structure(full, nodes, size=8, band=(0, 60), pairs={"link": ("middle", "tip")})
    assert [p.name for p in system.ports] == ["drive", "tip", "link"]
    by_x, _ = slopes(system)
    for part in (by_x[8:, :8], by_x[8:, 8:]):
        assert np.count_nonzero(part[3:] - np.diag(np.diagonal(part))[3:]) == 0
        assert np.count_nonzero(part[:3]) > 12
    form = system.form
    assert by_x[8:, :8] == pytest.approx(-np.linalg.solve(form.mass, form.stiffness), abs=1e-3)


def test_steps_are_those_of_the_band_beside_modes_above_it(small):
    """A mode at four times the band is followed stably; what a force in the band makes stays."""
    assert small.exact_to == 60.0
    rate = 240.0
    eigenvalues = 2j * np.pi * np.array([55.0, 240.0])
    assert steps_per_sample(eigenvalues, 1 / rate) == 21
    assert steps_per_sample(eigenvalues[:1], 1 / rate) == 5
    assert steps_per_sample(eigenvalues, 1 / rate, small.exact_to) == 7
    time = np.arange(480) / rate
    lines = np.arange(1, 120)[:, None] * 0.5
    turns = np.random.default_rng(2).random(lines.shape)
    force = {"force_drive": np.sin(2 * np.pi * (lines * time + turns)).sum(axis=0)}
    coarse, fine = (simulate(seed_model(small), time, force, substeps=n) for n in (7, 32))
    for name, exact in fine.channels.items():
        left = coarse.channels[name] - exact
        assert np.linalg.norm(left) < 1e-3 * np.linalg.norm(exact)
