# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-model simulate`: force history to contact history."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from finger_common.cli import one_line
from finger_common.errors import InputError, ModelError
from finger_common.files import atomic_write, check_outputs
from finger_common.progress import Stages

from ..fem.elasticity import ELASTICITIES, NEO_HOOKE
from ..geometry import Geometry
from ..history import ContactHistory, read_load_csv
from ..laws import ConstitutiveLaw, MaxwellLaw, StandardLinearSolid, load_material
from ..parameter_sets import ParameterSets

if TYPE_CHECKING:
    from ..slip.pull import PullHistory
    from ..solid3d.full_order import SolidHistory

FULL_ORDER = "full-order model"
"""Name of the stage in the progress."""


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "simulate",
        help="compute the contact under a force history",
        description=(
            "Simulate a finger under a force history. The input has the columns time_s,force_n, "
            "the output time_s,force_n,area_mm2,radius_mm,indentation_mm,peak_pressure_kpa with "
            "one row per input row. The finger is at rest before the first row. Without --solver "
            "the reduced model is used if there is one for the geometry, material and load, and "
            "the full-order model otherwise. A column tangential_force_n in the input, "
            "--pad-aspect and --tilt-deg need the full-order model in three dimensions (seconds a "
            "row; docs/third_dimension.md). Its output also has the columns semi_axis_a_mm, "
            "semi_axis_b_mm, stick_ratio, slip_margin, tangential_displacement_mm, "
            "orientation_deg, center_x_mm, center_y_mm. With --solver reduced, a column "
            "tangential_force_n gives stick_ratio, slip_margin, tangential_displacement_mm at "
            "once, by the law of the live estimate (docs/slip.md)."
        ),
        example=(
            "finger-model simulate --force force.csv -o contact.csv\n"
            "finger-model simulate --force force.csv --material material.yaml --solver full \\\n"
            "    --plot stress.png --vtu stress.vtu -o contact.csv\n"
            "finger-model simulate --force force.csv --parameters out/fit/parameters.yaml \\\n"
            "    --condition natural -o contact.csv\n"
            "finger-model simulate --force pull.csv --solver full --pad-aspect 1.3 --tilt-deg 15"
        ),
    )
    parser.add_argument("--force", required=True, metavar="CSV", help="columns time_s,force_n")
    model = parser.add_argument_group("finger and model")
    model.add_argument(
        "--geometry",
        metavar="YAML",
        help="geometry.yaml of the finger (default: the default finger)",
    )
    model.add_argument(
        "--material", metavar="YAML", help="law and parameters in SI (default: the natural set)"
    )
    model.add_argument(
        "--parameters",
        metavar="YAML",
        help="parameters.yaml of a fit or a calibration, in place of --material. It gives the law, "
        "one of its parameter sets and, if it holds them, the lengths",
    )
    model.add_argument(
        "--condition", default="", metavar="C", help="with --parameters: the set of this condition"
    )
    model.add_argument(
        "--moisture",
        type=float,
        metavar="X",
        help="with --parameters: the parameters at this reading of the moisture probe (a.u.)",
    )
    model.add_argument("--solver", choices=("reduced", "full"), help="model to use")
    model.add_argument(
        "--reduced-model", metavar="FILE", help="file of 'finger-model reduce' (default: shipped)"
    )
    model.add_argument(
        "--refinement",
        type=float,
        default=1.0,
        metavar="X",
        help="divides the node spacing of the full-order mesh (default: 1)",
    )
    model.add_argument(
        "--elasticity",
        choices=ELASTICITIES,
        default=NEO_HOOKE,
        help="strain measure of the full-order model (default: neo-hooke; the others are for "
        "comparison, see docs/paper_choices.md)",
    )
    solid = parser.add_argument_group("three dimensions")
    solid.add_argument(
        "--pad-aspect",
        type=float,
        metavar="R",
        help="elliptical pad: pad, skin, bone and nail R times as long along x as along y",
    )
    solid.add_argument(
        "--tilt-deg",
        type=float,
        nargs="+",
        metavar=("PITCH", "ROLL"),
        help="tilted plate: its side at +x rises by PITCH degrees, its side at +y by ROLL degrees",
    )
    pictures = parser.add_argument_group("pictures and fields")
    pictures.add_argument(
        "--plot", metavar="PNG", help="draw the deformed half-section with its von Mises stress"
    )
    pictures.add_argument("--vtu", metavar="FILE", help="save the fields for ParaView")
    pictures.add_argument(
        "--at",
        type=float,
        metavar="S",
        help="time of the row that --plot and --vtu show (default: largest force)",
    )
    parser.add_argument("-o", "--output", metavar="CSV", help="output file (default: terminal)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the subcommand."""
    names = ("force", "geometry", "material", "parameters", "reduced_model")
    inputs = [getattr(arguments, name) for name in names]
    check_outputs([arguments.output, arguments.plot, arguments.vtu], inputs)
    time, force, pull = read_load_csv(arguments.force)
    solver = _solver(arguments, pull)
    geometry, material = _finger(arguments)
    if not np.any(force > 0.0):
        print(
            f"{arguments.force}: no force above zero, so nothing touches; a pressing force is "
            "positive",
            file=sys.stderr,
        )
    if pull is not None and material.friction == 0.0 and np.any(pull != 0.0):
        raise InputError(
            f"{arguments.force}: 'tangential_force_n' needs friction, and the material has none; "
            "set 'friction' in the material file"
        )
    finger = geometry, material, time, force
    found: ContactHistory | PullHistory | SolidHistory
    if solver == "solid":
        found = _solid(arguments, *finger, pull)
    elif solver == "full":
        found = _full(arguments, *finger)
    else:
        try:
            found = _reduced(arguments, *finger, pull)
        except (InputError, ModelError) as error:
            if solver == "reduced":
                raise
            reason = one_line(error).partition(";")[0]  # without the remedy
            print(f"using the full-order model: {reason}", file=sys.stderr)
            found = _full(arguments, *finger)
    _write(found.csv_text(), arguments.output)
    return 0


def _solver(
    arguments: argparse.Namespace, pull: np.ndarray | None
) -> Literal["solid", "full", "reduced", "either"]:
    """The model that options and load call for; either: the reduced one where there is one for the
    finger and its load, else the full-order one.

    Raises InputError for options that do not go together.
    """
    fields = bool(arguments.plot or arguments.vtu)
    if Path(arguments.plot or "").suffix.lower() not in ("", ".png"):
        raise InputError(f"--plot {arguments.plot}: is drawn as PNG; give a name that ends in .png")
    default_mesh = arguments.refinement == 1.0 and arguments.elasticity == NEO_HOOKE
    full = arguments.solver == "full" or fields or not default_mesh
    if arguments.reduced_model and full:
        raise InputError(
            "--reduced-model does not go with --solver full, --refinement, --elasticity, --plot or "
            "--vtu, which are of the full-order model: leave one of them out"
        )
    reduced = arguments.solver == "reduced" or bool(arguments.reduced_model)
    posed = arguments.pad_aspect is not None or arguments.tilt_deg is not None
    if posed or (pull is not None and not reduced):
        if reduced:
            raise InputError(
                "--pad-aspect and --tilt-deg need three dimensions, and the reduced model is "
                "axisymmetric: use --solver full"
            )
        if arguments.elasticity != NEO_HOOKE:
            raise InputError("--elasticity is of the axisymmetric model: leave it out")
        if fields or arguments.at is not None:
            raise InputError("--plot, --vtu and --at are of the axisymmetric model: leave them out")
        return "solid"
    if reduced and fields:
        raise InputError("--plot and --vtu need the stress field: use --solver full")
    if arguments.at is not None and not fields:
        raise InputError("--at chooses what --plot and --vtu show: give one of them")
    if reduced and not default_mesh:
        raise InputError(
            "--refinement and --elasticity are of the full-order model: use --solver full"
        )
    if reduced:
        return "reduced"
    return "full" if full else "either"


def _finger(arguments: argparse.Namespace) -> tuple[Geometry, ConstitutiveLaw]:
    """Geometry and material that are asked for."""
    given = Geometry.load(arguments.geometry) if arguments.geometry else None
    if not arguments.parameters:
        if arguments.condition or arguments.moisture is not None:
            raise InputError("--condition and --moisture choose a set of --parameters: give it")
        material = load_material(arguments.material) if arguments.material else None
        return given or _built_for(arguments), material or StandardLinearSolid()
    if arguments.material:
        raise InputError("--material and --parameters: give one of the two")
    if arguments.condition and arguments.moisture is not None:
        raise InputError("--condition and --moisture: give one of the two")
    sets = ParameterSets.load(arguments.parameters)
    if arguments.moisture is None:
        vector = np.array(sets.of_condition(arguments.condition).parameters)
    else:
        at = sets.interpolate(arguments.moisture)
        vector = at.parameters
        if at.out_of_range:
            ends = " … ".join(f"{s.moisture:.4g}" for s in (sets.sets[0], sets.sets[-1]))
            print(
                f"--moisture {arguments.moisture:g} lies outside the sets of "
                f"{arguments.parameters} ({ends}): the nearest set is used",
                file=sys.stderr,
            )
    geometry = given or sets.geometry or _built_for(arguments)
    if sets.geometry_hash not in ("", geometry.hash()):
        raise InputError(
            f"{arguments.parameters}: fitted with another finger than "
            f"{arguments.geometry or arguments.reduced_model or 'the default one'}; give the "
            "geometry of the fit with "
            "--geometry"
        )
    return geometry, sets.law().with_vector(vector)


def _built_for(arguments: argparse.Namespace) -> Geometry:
    """The geometry of the reduced model's file; the default one without a file."""
    if not arguments.reduced_model:
        return Geometry()
    from ..finger import load_reduced

    return load_reduced(arguments.reduced_model).geometry


def _solid(
    arguments: argparse.Namespace,
    geometry: Geometry,
    material: ConstitutiveLaw,
    time: np.ndarray,
    force: np.ndarray,
    pull: np.ndarray | None,
) -> SolidHistory:
    """History of the full-order model in three dimensions."""
    from ..pose.pose import Pose
    from ..solid3d.full_order import SolidModel

    tilt = arguments.tilt_deg or [0.0]
    if len(tilt) > 2:
        raise InputError(f"--tilt-deg has {len(tilt)} values; give PITCH or PITCH ROLL")
    aspect = 1.0 if arguments.pad_aspect is None else arguments.pad_aspect
    pose = Pose(aspect, *(math.radians(angle) for angle in tilt))
    _check_output(arguments.output)
    model = SolidModel(geometry, pose, arguments.refinement)
    with Stages(brief=True) as stages:
        return model.simulate(
            material, time, force, pull, lambda done: stages.update(FULL_ORDER, done)
        )


def _check_output(*paths: str | None) -> None:
    """Raises InputError for a file that cannot be written, before the work."""
    for path in paths:
        if path and not Path(path).resolve().parent.is_dir():
            raise InputError(f"{path}: the folder does not exist; create it first")
        if path and Path(path).is_dir():
            raise InputError(f"{path}: is a folder; give the name of a file")


def _write(text: str, output: str | None) -> None:
    """Write to the file, or to the terminal where none is given."""
    if not output:
        sys.stdout.write(text)
        return
    with atomic_write(output) as file:
        file.write(text)


def _reduced(
    arguments: argparse.Namespace,
    geometry: Geometry,
    material: ConstitutiveLaw,
    time: np.ndarray,
    force: np.ndarray,
    pull: np.ndarray | None,
) -> ContactHistory | PullHistory:
    """History of the reduced model, under a pull with stick and slip."""
    from ..finger import simulate_reduced

    history = simulate_reduced(material, time, force, geometry, arguments.reduced_model or "")
    if pull is None:
        return history
    from ..slip.pull import pull_history

    assert isinstance(material, MaxwellLaw)  # as all that have a reduced model
    return pull_history(history, pull, geometry, material)


def _full(
    arguments: argparse.Namespace,
    geometry: Geometry,
    material: ConstitutiveLaw,
    time: np.ndarray,
    force: np.ndarray,
) -> ContactHistory:
    """History of the full-order model; also writes the figure and the file of the fields."""
    from ..fem.full_order import FullOrderModel

    row = int(np.argmax(force))
    if arguments.at is not None:
        if not time[0] <= arguments.at <= time[-1]:
            raise InputError(
                f"--at {arguments.at:g} s is outside the force history "
                f"({time[0]:g} … {time[-1]:g} s)"
            )
        row = int(np.argmin(np.abs(time - arguments.at)))
    _check_output(arguments.plot, arguments.vtu, arguments.output)
    model = FullOrderModel(geometry, arguments.refinement, elasticity=arguments.elasticity)
    stepper = model.start(material, float(time[0]))
    points = []
    with Stages(brief=True) as stages:
        for index in stages.track(range(len(time)), FULL_ORDER, len(time)):
            points.append(stepper.step(float(time[index]), float(force[index])))
            if index != row:
                continue
            if arguments.vtu:
                stepper.fields().to_vtu(arguments.vtu)
            if arguments.plot:
                from ..figures import half_section

                half_section(stepper.fields(), geometry, points[-1], arguments.plot)
    return ContactHistory.from_points(points)
