"""`finger-model simulate`: force history to contact history."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from finger_common.errors import InputError

from ..fem.elasticity import ELASTICITIES, NEO_HOOKE
from ..geometry import Geometry
from ..history import ContactHistory, read_force_csv
from ..laws import ConstitutiveLaw, StandardLinearSolid, load_material


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "simulate",
        help="compute the contact under a force history",
        description=(
            "Simulate a finger under a force history. The input has the columns time_s,force_n, "
            "the output time_s,force_n,area_mm2,radius_mm,indentation_mm,peak_pressure_kpa with "
            "one row per input row. The finger is at rest before the first row. Without --solver "
            "the reduced model is used where there is one for the geometry, material and load, "
            "and the full-order model otherwise."
        ),
        example=(
            "finger-model simulate --force force.csv -o contact.csv\n"
            "finger-model simulate --force force.csv --material material.yaml --solver full \\\n"
            "    --plot stress.png --vtu stress.vtu -o contact.csv"
        ),
    )
    parser.add_argument("--force", required=True, metavar="CSV", help="columns time_s,force_n")
    parser.add_argument("--geometry", metavar="YAML", help="lengths in m (default: built in)")
    parser.add_argument(
        "--material", metavar="YAML", help="law and parameters in SI (default: the natural set)"
    )
    parser.add_argument("--solver", choices=("reduced", "full"), help="model to use")
    parser.add_argument(
        "--reduced-model", metavar="FILE", help="file of 'finger-model reduce' (default: shipped)"
    )
    parser.add_argument(
        "--refinement",
        type=float,
        default=1.0,
        metavar="X",
        help="divides the node spacing of the full-order mesh (default: 1)",
    )
    parser.add_argument(
        "--elasticity",
        choices=ELASTICITIES,
        default=NEO_HOOKE,
        help="strain measure of the full-order model (default: neo-hooke; the others are for "
        "comparison, see docs/paper_choices.md)",
    )
    parser.add_argument(
        "--plot", metavar="PNG", help="draw the deformed half-section with its von Mises stress"
    )
    parser.add_argument("--vtu", metavar="FILE", help="save the fields for ParaView")
    parser.add_argument(
        "--at",
        type=float,
        metavar="S",
        help="time of the row that --plot and --vtu show (default: largest force)",
    )
    parser.add_argument("-o", "--output", metavar="CSV", help="output file (default: terminal)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the subcommand."""
    geometry = Geometry.load(arguments.geometry) if arguments.geometry else Geometry()
    material = load_material(arguments.material) if arguments.material else StandardLinearSolid()
    time, force = read_force_csv(arguments.force)
    wants_fields = bool(arguments.plot or arguments.vtu)
    if arguments.solver == "reduced" and wants_fields:
        raise InputError("--plot and --vtu need the stress field: use --solver full")
    if arguments.at is not None and not wants_fields:
        raise InputError("--at chooses what --plot and --vtu show: give one of them")
    history = None
    default_mesh = arguments.refinement == 1.0 and arguments.elasticity == NEO_HOOKE
    if arguments.solver != "full" and not wants_fields and default_mesh:
        history = _reduced(arguments, geometry, material, time, force)
    if history is None:
        if arguments.solver == "reduced":
            raise InputError(
                "--refinement and --elasticity are of the full-order model: use --solver full"
            )
        history = _full(arguments, geometry, material, time, force)
    if arguments.output:
        history.to_csv(arguments.output)
    else:
        sys.stdout.write(history.csv_text())
    return 0


def _reduced(
    arguments: argparse.Namespace,
    geometry: Geometry,
    material: ConstitutiveLaw,
    time: np.ndarray,
    force: np.ndarray,
) -> ContactHistory | None:
    """History of the reduced model; None, with a note, where the full-order model has to do it."""
    from ..reduced.model import ReducedModel

    try:
        model = ReducedModel.load(arguments.reduced_model, geometry=geometry)
        return model.for_law(type(material)).simulate(material, time, force)
    except InputError as error:
        if arguments.solver == "reduced" or arguments.reduced_model:
            raise
        print(f"using the full-order model: {error}", file=sys.stderr)
        return None


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
    for path in (arguments.plot, arguments.vtu, arguments.output):
        if path and not Path(path).resolve().parent.is_dir():
            raise InputError(f"{path}: the folder does not exist; create it first")
        if path and Path(path).is_dir():
            raise InputError(f"{path}: is a folder; give the name of a file")
    model = FullOrderModel(geometry, arguments.refinement, elasticity=arguments.elasticity)
    stepper = model.start(material, float(time[0]))
    points = []
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        for index in progress.track(range(len(time)), description="full-order model"):
            points.append(stepper.step(float(time[index]), float(force[index])))
            if index != row:
                continue
            if arguments.vtu:
                stepper.fields().to_vtu(arguments.vtu)
            if arguments.plot:
                from ..figures import half_section

                half_section(stepper.fields(), geometry, points[-1], arguments.plot)
    return ContactHistory.from_points(points)
