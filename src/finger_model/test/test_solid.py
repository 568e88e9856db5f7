# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The three-dimensional model: elements, condensation, contact laws, command."""

import csv
import math
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from finger_common.cli import run
from finger_common.errors import InputError, ModelError
from finger_model.cli import _main
from finger_model.fem.equilibrium import SLIP, STICK, NotConverged
from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.laws import GeneralizedMaxwell2, StandardLinearSolid
from finger_model.pose.pose import Pose
from finger_model.solid3d import contact_shape, elements, equilibrium, full_order
from finger_model.solid3d.condensation import Condensation, NotPositive
from finger_model.solid3d.contact import Plate, Sliding
from finger_model.solid3d.contact_shape import node_areas, outline
from finger_model.solid3d.full_order import SOLID_CSV_HEADER, SolidModel
from finger_model.solid3d.mesh import MeshSize, solid_mesh
from finger_model.verification.cases import CALCULIX_FINGER, elastic

COARSE = MeshSize(center=0.2, across=4, growth=1.3, bulk=3, bulk_growth=1.5, skin=1)
DRY = {"modulus": 30e3, "E2": 1652e3}


@pytest.fixture(scope="module")
def model():
    return SolidModel(size=COARSE)


def body(mesh, law):
    """Elements, neo-Hookean material and an array of tangents of a mesh."""
    bricks = elements.reference_bricks(mesh.nodes, mesh.cells)
    metric = np.zeros((*bricks.weight.shape, 6))
    metric[..., :3] = law.instantaneous_shear_modulus
    bulk = np.full(len(mesh.cells), law.bulk_modulus)
    tangent = np.zeros((len(mesh.cells), elements.UNKNOWNS, elements.UNKNOWNS))
    return bricks, elements.Stiffness(metric, elements.NO_SLOPE, bulk), tangent


def test_a_coarser_mesh_keeps_the_bending_of_the_skin():
    material = elastic(30e3, E2=1652e3)
    flat = FullOrderModel(CALCULIX_FINGER).start(material).step(1.0, 0.5)
    solid = SolidModel(CALCULIX_FINGER, refinement=0.5).start(material).step(1.0, 0.5)
    assert solid.area == pytest.approx(flat.area, rel=0.03)


@pytest.mark.parametrize(
    "pose", [Pose(), Pose(1.4), Pose(1.2, math.radians(25)), Pose(1.1, 0.2, -0.3)]
)
def test_mesh_fills_the_finger(pose):
    geometry = Geometry()
    mesh = solid_mesh(geometry, pose)
    volume = elements.reference_bricks(mesh.nodes, mesh.cells).weight.sum()
    g = geometry
    pad = g.pad_semi_axis_radial**2 * g.pad_semi_axis_axial
    bone = g.bone_semi_axis_radial**2 * g.bone_semi_axis_axial
    nail = (g.nail_radius**2 - g.bone_semi_axis_radial**2) * g.nail_thickness
    exact = pose.aspect * math.pi * (2 / 3 * (pad - bone) + nail)
    assert volume * mesh.copies == pytest.approx(exact, rel=0.025)
    # The plate touches first where the mesh is finest.
    skin = mesh.nodes[mesh.surface]
    spacing = np.sqrt(node_areas(mesh, skin))
    assert spacing[np.argmin(skin[:, 2])] < np.median(spacing)


@pytest.mark.parametrize("stiffening", [False, True])
def test_tangent_is_the_derivative_of_the_force(stiffening):
    slope = 20e3
    mesh = solid_mesh(Geometry(), Pose(1.2, 0.3), COARSE)
    law = elastic(**DRY)
    bricks, material, tangent = body(mesh, law)
    rng = np.random.default_rng(2)
    x = mesh.nodes @ (np.eye(3) + 0.1 * rng.normal(size=(3, 3)))
    step = 1e-8 * rng.normal(size=x.shape)
    forces = []
    for sign in (1, -1, 0):
        force = np.zeros_like(x)
        moved = x + sign * step
        if stiffening:
            excess = elements.first_invariant(moved, bricks) - 3.0
            metric = np.zeros_like(material.metric)
            metric[..., :3] = (law.instantaneous_shear_modulus + slope * excess)[..., None]
            material = material._replace(metric=metric, slope=np.full(excess.shape, slope))
        elements.assemble(moved, bricks, material, sign == 0, force, tangent)
        forces.append(force)
    expected = np.zeros_like(x)
    local = np.einsum("eij,ej->ei", tangent, step[mesh.cells].reshape(len(mesh.cells), -1))
    np.add.at(expected, mesh.cells, local.reshape(*mesh.cells.shape, 3))
    error = np.abs(0.5 * (forces[0] - forces[1]) - expected).max() / np.abs(expected).max()
    assert error < 1e-6


def test_uniform_gradient_gives_uniform_strain():
    mesh = solid_mesh(Geometry(), Pose(1.2), COARSE)
    bricks = elements.reference_bricks(mesh.nodes, mesh.cells)
    f = np.array([[1.1, 0.2, 0.0], [0.05, 0.9, 0.1], [0.0, -0.1, 1.0]])
    shape = (*bricks.weight.shape, 6)
    c_bar, inverse, volume = np.empty(shape), np.empty(shape), np.empty(shape[:2])
    elements.strain_measures(mesh.nodes @ f.T, bricks, c_bar, inverse, volume)
    j = np.linalg.det(f)
    c = j ** (-2 / 3) * f.T @ f
    for found, tensor in ((c_bar, c), (inverse, np.linalg.inv(c))):
        exact = tensor[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
        assert np.allclose(found, exact, atol=1e-9)
    assert np.allclose(volume, j)


def test_condensation_equals_elimination_by_hand():
    mesh = solid_mesh(Geometry(), None, MeshSize(0.2, 2, 1.6, 2, 1.5, 1))
    bricks, material, tangent = body(mesh, elastic(**DRY))
    elements.assemble(mesh.nodes, bricks, material, True, np.zeros_like(mesh.nodes), tangent)
    kept = mesh.surface[:9]
    condensation = Condensation(mesh.cells, mesh.place, mesh.fixed, kept)
    n = mesh.nodes.size
    full = np.zeros((n, n))
    dofs = (3 * mesh.cells[:, :, None] + np.arange(3)).reshape(len(mesh.cells), -1)
    for block, where in zip(tangent, dofs):
        full[np.ix_(where, where)] += block
    load = np.random.default_rng(0).normal(size=n)
    load[mesh.fixed.ravel()] = 0.0
    inside = ~mesh.fixed.ravel()
    inside[condensation.kept_dofs] = False
    keep = condensation.kept_dofs[~mesh.fixed.ravel()[condensation.kept_dofs]]
    free = ~mesh.fixed.ravel()[condensation.kept_dofs]
    stiffness = condensation.factorize(tangent)[np.ix_(free, free)]
    solved = np.linalg.solve(full[np.ix_(inside, inside)], full[np.ix_(inside, keep)])
    exact = full[np.ix_(keep, keep)] - full[np.ix_(keep, inside)] @ solved
    assert np.allclose(stiffness, exact, atol=1e-9 * np.abs(exact).max())
    assert np.allclose(condensation.reduce(load)[free], load[keep] - solved.T @ load[inside])
    moved = np.zeros(len(condensation.kept_dofs))
    moved[free] = np.linspace(-1, 1, len(keep))
    out = condensation.expand(moved)
    residual = full[np.ix_(inside, inside)] @ out[inside] - load[inside]
    residual += full[np.ix_(inside, keep)] @ moved[free]
    assert np.abs(residual).max() < 1e-9 * np.abs(load).max()


def laws_hold(stepper, friction):
    """Signorini's and Coulomb's laws at every node; returns how many stick and slip."""
    contact, mesh = stepper.state.contact, stepper.model.mesh
    gap = stepper.state.positions[mesh.surface, 2] - contact.plate[2]
    largest = contact.force[:, 2].max()
    assert gap.min() > -1e-10
    assert contact.force[:, 2].min() > -1e-6 * largest
    assert np.abs(contact.force[:, 2] * gap).max() < 1e-10 * largest
    size = np.hypot(contact.force[:, 0], contact.force[:, 1])
    assert np.all(size < friction * contact.force[:, 2] + 1e-5 * friction * largest)
    slips = contact.status == SLIP
    assert np.allclose(size[slips], friction * contact.force[slips, 2], atol=1e-5 * largest)
    sticks = contact.status == STICK
    moved = stepper.state.positions[mesh.surface, :2] - contact.plate[:2] - contact.anchor
    assert np.abs(moved[sticks]).max(initial=0.0) < 1e-10
    assert np.all(np.sum(contact.force[slips, :2] * moved[slips], axis=1) <= 1e-15)
    return int(sticks.sum()), int(slips.sum())


def test_pull_from_stick_to_slip_and_back(model):
    friction, load = 0.4, 0.4
    stepper = model.start(elastic(**DRY, friction=friction))
    for k in range(1, 4):
        point = stepper.step(k, load * k / 3, (0.0, 0.0))
    assert point.force == pytest.approx(load, rel=1e-6)
    assert point.tangential_x == pytest.approx(0.0, abs=1e-6)
    ratios, shifts = [], []
    for k, part in enumerate((0.2, 0.5, 0.8, 0.95), start=4):
        point = stepper.step(k, load, (part * friction * load, 0.0))
        laws_hold(stepper, friction)
        assert point.tangential_x == pytest.approx(part * friction * load, rel=1e-5)
        assert point.slip_margin == pytest.approx(1 - part, abs=1e-4)
        ratios.append(point.stick_ratio)
        shifts.append(point.shift_x)
    assert all(np.diff(ratios) < 0) and ratios[0] > 0.8 and ratios[-1] < 0.3
    assert all(np.diff(shifts) > 0)
    held = stepper.state
    stepper.step(8.0, load, (0.5 * friction * load, 0.0))
    back = stepper.point()
    assert back.stick_ratio > 0.6, "a pull that turns back sticks again"
    assert back.shift_x > shifts[1], "the way back is another one (hysteresis)"
    stepper.state = held
    slid = stepper.step(8.0, load, (1.2 * friction * load, 0.0))
    assert stepper.sliding and slid.stick_ratio == 0.0 and slid.slip_margin == 0.0
    assert slid.tangential_x == pytest.approx(friction * load, rel=5e-3)


@pytest.mark.parametrize("friction", [0.25, 0.8])
def test_a_plate_that_slides_from_first_touch_on_is_followed(model, friction):
    """As where a sensor's noise is larger than friction: it took minutes, or found nothing."""
    stepper = model.start(elastic(**DRY, friction=friction))
    shifts = []
    for k in range(1, 6):
        point = stepper.step(k, 0.1 * k, (0.13 * friction * k, 0.0))
        assert stepper.sliding and point.stick_ratio == point.slip_margin == 0.0
        assert point.tangential_x == pytest.approx(friction * point.force, rel=1e-6)
        shifts.append(point.shift_x)
    assert shifts[0] > 0.0 and all(np.diff(shifts) > 0.0)
    # With less pull it sticks where it came to lie.
    held = stepper.step(6.0, 0.5, (0.9 * 0.5 * friction, 0.0))
    assert not stepper.sliding and held.stick_ratio > 0.5
    laws_hold(stepper, friction)


def pressed(model, law, load=0.6):
    """A finger pressed in two steps, and a function that pulls it by shares of its friction, a
    step each, and gives the points."""
    stepper = model.start(law)
    for k in (1, 2):
        stepper.step(0.25 * k, 0.5 * k * load)

    def pull(*shares, load=load):
        bound = law.friction * load
        return [
            stepper.step(stepper.state.time + 0.05, load, (share * bound, 0.0)) for share in shares
        ]

    return stepper, pull


@pytest.mark.parametrize("share", [0.985, 0.9999])
def test_a_pull_just_below_friction_leaves_no_skin_that_sticks(model, monkeypatch, share):
    """The skin spreads while it slips, not along the pull alone: all of it slips below μP. It took
    minutes, and found nothing."""
    monkeypatch.setattr(full_order, "SMALLEST_CUT", 0.2)
    law = StandardLinearSolid()
    stepper, pull = pressed(model, law)
    before = pull(0.5, 0.9, 0.97)[-1]
    assert 0.0 < before.stick_ratio < 0.2
    slid, held, beyond = pull(share, share, 1.2)
    assert slid.stick_ratio == 0.0
    assert slid.slip_margin == pytest.approx(1.0 - share)
    assert slid.tangential_x == pytest.approx(share * law.friction * 0.6, rel=0.05)
    assert 1.0 < slid.shift_x / before.shift_x < 1.25
    assert held.shift_x == beyond.shift_x == slid.shift_x
    assert held.stick_ratio == beyond.stick_ratio == beyond.slip_margin == 0.0
    # As the pull falls and turns, the plate goes back as it does from a slide beyond friction.
    back = pull(0.5, 0.0, -0.5, -1.2)
    _, other = pressed(model, law)
    other(0.5, 0.9, 0.97, 1.0, 1.0, 1.0)
    for found, expected in zip(back, other(0.5, 0.0, -0.5, -1.2), strict=True):
        assert found.shift_x == pytest.approx(expected.shift_x, abs=2e-6)
        assert found.stick_ratio == pytest.approx(expected.stick_ratio, abs=0.01)
    assert stepper.sliding and back[-1].tangential_x < 0.0 == back[-1].slip_margin


def test_a_plate_that_slides_stays_where_the_slide_began(model):
    """Tissue creeps under friction, and took the plate with it by a fifth of its way."""
    _, pull = pressed(model, StandardLinearSolid())
    first, *held = pull(0.9, 1.2, 1.2, 1.3, 1.2)[1:]
    assert [point.shift_x for point in held] == [first.shift_x] * 3
    # More force bends the skin further.
    assert pull(1.2, load=0.8)[0].shift_x > 1.1 * first.shift_x
    back, again = pull(-1.2, -1.2)
    assert back.shift_x < 0.0 and again.shift_x == back.shift_x


def test_a_pull_within_friction_that_finds_no_balance_names_the_cause(model, monkeypatch):
    stepper, pull = pressed(model, StandardLinearSolid())
    before = stepper.state

    def slides(*_):
        raise Sliding

    monkeypatch.setattr(model.equilibrium, "solve", slides)
    with pytest.raises(ModelError, match=r"no skin sticks .* not used up; lower the pull") as error:
        pull(0.5)
    assert "stiffer moduli" not in str(error.value)
    assert stepper.state is before


def test_without_friction_nothing_is_said_of_slip(model):
    law = StandardLinearSolid(friction=0.0)
    found = model.simulate(law, [0.2, 0.5], [0.3, 0.6], [0.0, 0.0])
    assert found.area.min() > 0.0
    assert np.isnan(found.stick_ratio).all() and np.isnan(found.slip_margin).all()
    # Rounding of the force along the plate pulled it by 12 µm.
    assert np.abs(found.shift_x).max() < 1e-12


@pytest.mark.parametrize(
    "pull", [np.zeros((2, 1)), np.zeros(3), np.zeros((2, 3)), 0.1, "ab", [[0.1], [0.1, 0.2]]]
)
def test_tangential_forces_of_another_shape_are_refused(model, pull):
    with pytest.raises(InputError, match=r"tangential force.*; give"):
        model.simulate(StandardLinearSolid(), [0.0, 1.0], [0.1, 0.1], pull)


def test_sticking_skin_may_hang_on_a_spring():
    friction, stiffness = 0.4, 2e9
    model = SolidModel(CALCULIX_FINGER, size=COARSE, stick_stiffness=stiffness)
    stepper = model.start(elastic(**DRY, friction=friction))
    stepper.step_to_position(1.0, 0.7e-3)
    stepper.step_to_position(2.0, 0.7e-3, (0.1e-3, 0.0))
    contact, mesh = stepper.state.contact, model.mesh
    sticks, slips = contact.status == STICK, contact.status == SLIP
    assert sticks.any() and slips.any()
    area = node_areas(mesh, mesh.nodes[mesh.surface])
    slid = stepper.state.positions[mesh.surface, :2] - contact.plate[:2] - contact.anchor
    pulled = (contact.begun - stiffness * area[:, None] * slid)[sticks]
    pulled[np.abs(mesh.disc[sticks, 1]) < 1e-12, 1] = 0.0
    largest = friction * contact.force[:, 2].max()
    assert np.allclose(contact.force[sticks, :2], pulled, atol=1e-6 * largest)
    size = np.hypot(contact.force[:, 0], contact.force[:, 1])
    assert np.all(size[sticks] <= friction * contact.force[sticks, 2] + 1e-6 * largest)
    assert np.allclose(size[slips], friction * contact.force[slips, 2], atol=1e-5 * largest)


def test_tissue_that_buckles_is_given_up_soon(monkeypatch):
    model = SolidModel(size=COARSE)
    stepper = model.start(elastic(**DRY))
    stepper.step(0.1, 0.1)
    model.equilibrium.forget()
    factorize, tried = Condensation.factorize, []

    def buckles(self, tangent):
        tried.append(1)
        if len(tried) > 1:
            raise NotPositive
        return factorize(self, tangent)

    monkeypatch.setattr(Condensation, "factorize", buckles)
    monkeypatch.setattr(equilibrium, "SLOW", 0.0)  # factorise at every iteration
    state = stepper.state
    material = stepper.solid.step(0.0, state.tissue)
    plate = Plate(np.array([0.0, 0.0, math.nan]), np.array([0.0, 0.0, 0.5]))
    with pytest.raises(NotConverged, match="buckles"):
        model.equilibrium.solve(state.positions, state.contact, material, 0.0, plate)
    assert len(tried) <= 10


def test_half_and_whole_finger_agree():
    law = StandardLinearSolid(friction=0.5)
    size = MeshSize(center=0.2, across=3, growth=1.4, bulk=2, skin=1)
    points = []
    for half in (True, False):
        stepper = SolidModel(pose=Pose(1.2, 0.2), size=size, half=half).start(law)
        stepper.step_to_position(0.2, 0.4e-3)
        points.append(stepper.step_to_position(0.4, 0.6e-3, (0.2e-3, 0.0)))
    for name in ("force", "tangential_x", "area", "semi_axis_a", "center_x"):
        ours, whole = (getattr(p, name) for p in points)
        assert ours == pytest.approx(whole, rel=2e-3, abs=1e-6), name
    # A node that slides by just 5 % of the plate's travel may fall on either side.
    assert points[0].stick_ratio == pytest.approx(points[1].stick_ratio, abs=0.03)
    with pytest.raises(InputError, match="half=False"):
        SolidModel(size=size).start(law).step_to_position(1.0, 1e-4, (0.0, 1e-4))


def test_threads_share_a_model():
    shared = SolidModel(size=MeshSize(center=0.2, across=3, growth=1.4, bulk=2, skin=1))
    laws = [StandardLinearSolid(E0=modulus) for modulus in (80e3, 120e3)]

    def press(law):
        stepper = shared.start(law)
        return [stepper.step(0.1 * k, 0.3 * k).area for k in range(1, 4)]

    alone = [press(law) for law in laws]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(2) as threads:
            found = list(threads.map(press, laws))
    finally:
        sys.setswitchinterval(interval)
    # Steps of others leave other tangents behind.
    assert np.array(found) == pytest.approx(np.array(alone), rel=0.02)


def test_a_geometry_and_a_pose_of_another_type_are_refused():
    with pytest.raises(InputError, match="geometry is of type dict; give a Geometry"):
        SolidModel({"nail_radius": 6e-3})
    with pytest.raises(InputError, match="pose is of type tuple; give a Pose"):
        SolidModel(pose=(1.3, 0.2))


def test_pull_turns_with_its_direction():
    law = elastic(**DRY, friction=0.5)
    size = MeshSize(center=0.2, across=3, growth=1.4, bulk=2, skin=1)
    whole = SolidModel(size=size, half=False)
    found = []
    for angle in (0.0, 0.5 * math.pi):
        stepper = whole.start(law)
        stepper.step_to_position(1.0, 0.5e-3)
        way = 0.15e-3 * math.cos(angle), 0.15e-3 * math.sin(angle)
        point = stepper.step_to_position(2.0, 0.5e-3, way)
        found.append((point.tangential_x, point.tangential_y, point.force))
    assert found[0][0] == pytest.approx(found[1][1], rel=1e-3)
    assert abs(found[0][1]) < 1e-3 * found[0][0]
    assert found[0][2] == pytest.approx(found[1][2], rel=1e-3)


@pytest.fixture(scope="module")
def whole():
    size = MeshSize(center=0.2, across=4, growth=1.4, bulk=2, skin=1)
    return SolidModel(size=size, half=False)


def test_a_plate_that_turns_twists_the_skin_until_all_slips_and_back(whole):
    law = elastic(**DRY, friction=0.5)
    stepper = whole.start(law)
    pressed = [stepper.step(0.5 * k, 0.25 * k) for k in (1, 2)][-1]
    bound = 0.5 * 0.5 * pressed.radius
    assert abs(pressed.twist_torque) < 1e-6 * bound
    angles = (0.01, 0.02, 0.05, 0.1)
    forth = [stepper.step(2.0 + k, 0.5, twist=angle) for k, angle in enumerate(angles)]
    torque, stick = (
        np.array([getattr(p, n) for p in forth]) for n in ("twist_torque", "stick_ratio")
    )
    assert np.all(np.diff(torque) > 0.0) and np.all(np.diff(stick) < 0.0) and stick[-1] < 0.02
    # Where all slips, each place has its friction across its way from the centre of the turn.
    normal = stepper.state.contact.force[:, 2]
    arm = np.hypot(*stepper.state.positions[whole.mesh.surface, :2].T)
    assert torque[-1] == pytest.approx(0.5 * normal @ arm, rel=0.01)
    # Hertz has 0.589, even pressure 0.667.
    assert torque[-1] / (0.25 * forth[-1].radius) == pytest.approx(0.63, abs=0.01)
    assert math.hypot(forth[-1].tangential_x, forth[-1].tangential_y) < 1e-6
    # On the way back friction turns, so that twice the angle takes twice the torque (Masing).
    back = stepper.step(7.0, 0.5, twist=0.1 - 2 * 0.05)
    assert torque[-1] - back.twist_torque == pytest.approx(2.0 * torque[2], rel=0.01)
    assert stepper.step(8.0, 0.5, twist=-0.1).twist_torque == pytest.approx(-torque[-1], rel=0.01)


def test_a_turn_about_a_place_beside_the_contact_pulls_and_twists(whole):
    """Far from it, the plate hardly twists. Turned in the air, it does neither."""
    law = elastic(**DRY, friction=0.5)
    found = []
    for distance, angle in ((0.0, 0.1), (4e-3, 0.2), (50e-3, 0.01)):
        stepper = whole.start(law)
        stepper.step(0.1, 0.0, twist=0.4)
        touched = [stepper.step(0.5 * k, 0.25 * k, twist=0.4) for k in (1, 2)][-1]
        assert abs(touched.twist_torque) < 1e-8
        for k, part in enumerate((0.2, 0.5, 1.0)):
            shift = 0.0, part * angle * distance
            point = stepper.step(2.0 + k, 0.5, None, shift, 0.4 + part * angle)
        pull = math.hypot(point.tangential_x, point.tangential_y)
        found.append((pull / 0.25, point.twist_torque / (0.25 * point.radius)))
    (q0, t0), (q1, t1), (q2, t2) = found
    assert q0 < 0.01 and q2 > 0.75 and t2 < 0.15 * t0
    assert 0.6 < q1 < 0.85 and 0.93 < math.hypot(q1, t1 / t0) < 1.0, "just within the ellipse"


def test_a_twist_needs_the_whole_finger_and_a_plate_whose_shift_is_given(model, whole):
    law = elastic(**DRY, friction=0.5)
    with pytest.raises(InputError, match="a twist needs the whole finger: use half=False"):
        model.start(law).step(1.0, 0.3, twist=0.1)
    with pytest.raises(InputError, match="give the shift instead"):
        whole.start(law).step(1.0, 0.3, (0.01, 0.0), twist=0.1)
    with pytest.raises(InputError, match="finite numbers"):
        whole.start(law).step_to_position(1.0, 1e-4, twist=math.nan)


def test_skin_that_has_just_touched_carries_a_pull_within_friction(model):
    law = elastic(**DRY, friction=0.25)
    still, right, left = (
        model.start(law).step(0.3, 0.5, (pull, 0.0)) for pull in (0.0, 0.05, -0.05)
    )
    assert still.slip_margin == 1.0 and abs(still.shift_x) < 1e-9
    assert (right.slip_margin, left.slip_margin) == pytest.approx((0.6, 0.6))
    assert right.stick_ratio > 0.9 and left.stick_ratio > 0.9
    assert right.shift_x == pytest.approx(-left.shift_x, rel=1e-2)


def test_viscoelastic_tissue_creeps_and_returns(model):
    law = GeneralizedMaxwell2(stiffening=1.0)
    stepper = model.start(law)
    fast = stepper.step(0.01, 0.3)
    held = stepper.step(3.0, 0.3)
    assert held.area > 1.1 * fast.area and held.indentation > fast.indentation
    gone = stepper.step(3.01, 0.0)
    assert gone.area == 0.0 and math.isnan(gone.stick_ratio) and gone.indentation > 0.05e-3
    assert stepper.step(60.0, 0.0).indentation < 0.02e-3


def test_few_rows_of_creeping_tissue_give_what_many_give(model):
    rows, load = np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.8, 0.8])
    pull = np.array([0.0, 0.0, 0.1])
    fine = np.linspace(0.0, 1.0, 41)
    many = model.simulate(
        StandardLinearSolid(), fine, np.interp(fine, rows, load), np.interp(fine, rows, pull)
    )
    few = model.simulate(StandardLinearSolid(), rows, load, pull)
    assert np.allclose(few.area[1:], many.area[[20, 40]], rtol=0.008)
    assert np.allclose(few.indentation[1:], many.indentation[[20, 40]], rtol=0.008)
    # Travel and stick ratio of a row are of the whole row, however it was divided.
    assert few.shift_x[2] == pytest.approx(many.shift_x[40], rel=0.02)
    assert 0.3 < few.stick_ratio[2] < 1.0


def test_outline_finds_a_known_ellipse(model, monkeypatch):
    monkeypatch.setattr(contact_shape, "EDGE_SHIFT", 0.0)
    mesh = model.mesh
    skin = mesh.nodes[mesh.surface].copy()
    contact = model.equilibrium.unloaded_contact()
    a, b = 3.1e-3, 2.4e-3
    reach = np.hypot(skin[:, 0] / a, skin[:, 1] / b)
    contact.plate[2] = -6.5e-3
    skin[:, 2] = -6.5e-3 + 0.3e-3 * np.maximum(reach - 1.0, 0.0) ** 1.5
    contact.status[reach <= 1.0] = STICK
    found = outline(mesh, skin, contact, node_areas(mesh, skin))
    assert found.area == pytest.approx(math.pi * a * b, rel=5e-3)
    assert found.semi_axes == pytest.approx((a, b), rel=0.01)
    assert abs(found.orientation) < 0.01 and np.abs(found.center).max() < 0.03e-3


def test_command_with_tangential_force_ellipse_and_tilt(tmp_path, capsys):
    force, out = tmp_path / "f.csv", tmp_path / "o.csv"
    force.write_text(
        "time_s,force_n,tangential_force_n\n0.1,0.2,0\n0.2,0.2,0.03\n0.3,0.2,0.2\n0.4,0,0\n"
    )
    arguments = ["simulate", "--force", str(force), "--solver", "full", "--refinement", "0.4"]
    arguments += ["--pad-aspect", "1.3", "-o", str(out)]
    assert run(_main, arguments) == 0
    assert out.read_text().splitlines()[0] == SOLID_CSV_HEADER
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["force_n"] for row in rows] == ["0.2", "0.2", "0.2", "0.0"]
    first, pulled, slid, gone = ({k: float(v) for k, v in row.items()} for row in rows)
    assert first["semi_axis_a_mm"] > 1.1 * first["semi_axis_b_mm"]
    assert pulled["slip_margin"] == pytest.approx(1 - 0.03 / (0.25 * 0.2), abs=1e-3)
    assert 0 < pulled["stick_ratio"] < 1 and pulled["tangential_displacement_mm"] > 0
    assert slid["stick_ratio"] == 0 and slid["slip_margin"] == 0
    assert gone["area_mm2"] == 0 and math.isnan(gone["stick_ratio"])
    for extra, words in (
        (["--solver", "reduced"], "--solver full"),
        (["--tilt-deg", "60"], "tilt"),
        (["--tilt-deg", "1", "2", "3"], "PITCH"),
        (["--pad-aspect", "5"], "aspect"),
        (["--plot", "x.png"], "--plot"),
    ):
        assert run(_main, [*arguments, *extra]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    "pose", [(5.0, 0.0), (1.0, 2.0), (1.0, math.nan), ("1.2", 0.0), (1.0, None), (True, 0.0)]
)
def test_impossible_pose_is_refused(pose):
    with pytest.raises(InputError):
        Pose(*pose)
