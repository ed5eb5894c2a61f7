"""What hides in structures: their elements and their true motion against closed forms."""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

from experiments.structures import cases, truth
from experiments.structures.kinds import KINDS
from experiments.structures.mesh import STEEL, blocks, in_bending, plane_stress, tied

MODULUS, _, DENSITY = STEEL


def lowest(matrices, groups, held, count=2):
    basis = tied(matrices["M"].shape[0], groups, held)
    mass, stiffness = (basis.T @ matrices[k] @ basis for k in "MK")
    values = eigsh(stiffness.tocsc(), count, mass.tocsc(), sigma=0.0, return_eigenvectors=False)
    return np.sqrt(np.sort(values))


def test_a_sheet_bends_as_a_beam():
    """Euler and Bernoulli's cantilever: w = 1.8751^2 sqrt(E I / rho A) / L^2, slender to 0.2 %."""
    mesh = blocks((np.linspace(0, 0.01, 3), np.linspace(0, 0.8, 81)))
    held = (2 * mesh.at(0.0)[:, None] + np.arange(2)).ravel()
    (first, _) = lowest(plane_stress(mesh, 0.04), [], held)
    due = 1.8751**2 * np.sqrt(MODULUS * 0.01**2 / 12 / DENSITY) / 0.8**2
    assert first == pytest.approx(due, rel=2e-3)


def test_a_tube_bends_as_a_beam_and_has_the_mass_of_one():
    """Clamped: a cantilever, radius of gyration sqrt(a^2 + b^2) / 2; rigid: pi r^2 rho L."""
    mesh = blocks((np.array([0.005, 0.010, 0.015]), np.linspace(0, 1, 101)))
    parts = in_bending(mesh)
    held = (3 * mesh.at(0.0)[:, None] + np.arange(3)).ravel()
    first = lowest(parts, [], held)[0]
    due = 1.8751**2 * np.sqrt(MODULUS / DENSITY) * np.hypot(0.005, 0.015) / 2
    assert first == pytest.approx(due, rel=5e-3)
    rigid = np.tile([1.0, -1.0, 0.0], len(mesh.points))
    tube = np.pi * (0.015**2 - 0.005**2) * DENSITY
    assert rigid @ parts["M"] @ rigid == pytest.approx(tube)
    assert rigid @ parts["K"] @ rigid == pytest.approx(0.0, abs=1e-3)
    tilted = np.zeros((len(mesh.points), 3))
    tilted[:, 2] = mesh.points[:, 0]  # W = r: a section turns; its polar moment is what G holds
    polar = np.pi / 2 * (0.015**4 - 0.005**4) * DENSITY
    assert tilted.ravel() @ parts["G"] @ tilted.ravel() == pytest.approx(polar)


def test_effects_and_places_are_all_among_the_cases():
    for name in KINDS:
        kind = KINDS[name]()
        assert kind.matrices["K"].shape[0] >= 10_000 or name == "ross"
        assert len(kind.using("sensor")) == 2
        drawn = {cases.of_case(name, n) for n in range(20)}
        assert {effect for effect, _ in drawn} == set(truth.LAWS) - {"none"}
        assert {port for _, port in drawn} == set(kind.places)


def test_the_true_motion_keeps_its_energy_and_its_statics():
    """A slow force bends the beam as its compliance says, with a spring at the place as well."""
    step = 1.0 / 600 / truth.STEPS
    force = np.minimum(np.arange(30_000) * step / 0.5, 1.0)
    side = truth.compliance("beam", "drive")
    _, alone = truth.motion("beam", "drive", "none", (0.0, 0.0), 0.5, 0.0, force, step)
    assert alone[-1] == pytest.approx(side, rel=2e-2)
    hold = (1.0 / side, 0.0)  # a gap of zero: a linear spring as stiff as the beam
    _, held = truth.motion("beam", "drive", "clearance", hold, 0.5, 0.0, force, step)
    assert held[-1] == pytest.approx(side / 2, rel=2e-2)


def test_the_rotor_of_ross_has_its_published_frequencies():
    """ROSS's documentation of ``rotor_example``: 92, 96, 275, 297 rad/s at rest."""
    matrices = KINDS["ross"]().matrices
    squares = eigh(matrices["K"].toarray(), matrices["M"].toarray(), eigvals_only=True)
    np.testing.assert_allclose(np.sqrt(squares[:4]), [92, 96, 275, 297], atol=0.5)
    modes = truth.modes("ross")
    np.testing.assert_allclose(modes.squares, squares, rtol=1e-6)
