"""Every reader of a file from outside, by the kind of file it reads.

A reader takes the file and a folder's name to write to. It gives an exit code or nothing, or raises
a FingerError. The kind of a file is its name up to the first "-" or ".".
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import finger_driver
import finger_model
from finger_bag.cli import command as bag_command
from finger_bag.mapping import TopicMapping
from finger_bringup.parameter_files import ParameterFile
from finger_common.cli import run
from finger_common.errors import InputError
from finger_common.files import read_csv
from finger_common.settings import Settings
from finger_driver.camera.info import CameraCalibration
from finger_driver.protocols.dbc import SensorMapping
from finger_driver.protocols.export_table import TableFormat, parse_table
from finger_driver.protocols.netft_xml import parse as parse_netft
from finger_fit.cli import command as fit_command
from finger_fit.search import population
from finger_fit.study.bags import bag_hash
from finger_model.estimator import EstimatorSettings
from finger_model.geometry import Geometry
from finger_model.laws import StandardLinearSolid
from finger_model.parameter_sets import ParameterSets
from finger_model.reduced import ReducedModel
from finger_offline.importing.tables import read_table
from finger_offline.trials import load_trials
from finger_operator.event_log import EVENTS_FILE, Event, EventLog
from finger_operator.protocol import Protocol
from finger_vision.calibration import PlateCalibration
from finger_vision.cli import main as vision_main

Reader = Callable[[Path, Path], Any]


def _bag(name: str, *options: str) -> Reader:
    def read(path: Path, out: Path) -> int:
        more = [str(out) if option == "OUT" else option for option in options]
        return run(bag_command, [name, str(path), *more])

    return read


def _folder(path: Path) -> Path:
    """A bag folder around a metadata.yaml, beside the bag of the corpus."""
    folder = path.parent / "bag"
    if not folder.exists():
        folder.mkdir()
        (folder / "metadata.yaml").write_bytes(path.read_bytes())
        (folder / "bag_0.mcap").write_bytes((CORPUS / "bag.mcap").read_bytes())
    return folder


def _metadata(path: Path, out: Path) -> int:
    return run(bag_command, ["info", "--count", str(_folder(path))])


def _metadata_hash(path: Path, out: Path) -> None:
    bag_hash(_folder(path))


def _attached(path: Path, out: Path) -> None:
    """As the calibration that is attached to a bag."""
    PlateCalibration.from_yaml(path.read_bytes().decode(errors="replace"), "attached")


def _plate(path: Path, out: Path) -> None:
    plate = PlateCalibration.load(path)
    plate.to_plate(np.zeros((1, 2)), 64, 48)


def _vision(path: Path, out: Path) -> int:
    return int(vision_main(["area", str(path), "-o", str(out)]) or 0)


def _coarse(path: Path, out: Path) -> int:
    """With pixels larger than those that are measured: the image is not reduced."""
    arguments = ["area", str(path), "--area-per-pixel", "1e-8", "-o", str(out)]
    return int(vision_main(arguments) or 0)


def _table(path: Path, out: Path) -> None:
    parse_table(path.read_bytes(), path.name, TableFormat())


def _columns(path: Path, out: Path) -> None:
    """As a table of a laboratory: every column as numbers and as times."""
    table = read_table(str(path))
    for heading in table.columns:
        for read in (table.numbers, table.times):
            try:
                read(heading)
            except InputError as error:
                refused = error
                continue
            break
        else:
            raise refused


def _fits(path: Path, out: Path) -> int:
    return run(fit_command, ["population", str(path), "-o", str(out)])


def _checkpoint(path: Path, out: Path) -> None:
    population._load(path, {"seed": 1})


def _session(path: Path, out: Path) -> None:
    folder = path.parent / "session"
    folder.mkdir()
    (folder / "session.json").write_bytes(path.read_bytes())
    effects: list[Any] = []
    protocol = Protocol.resume_from(folder, effects.append, 10**18)
    protocol.resume(10**18)
    protocol.start(10**18)
    for effect in effects:
        bag = Path(getattr(effect, "path", folder / "bag")).resolve()
        if bag.parent != folder.resolve():
            raise AssertionError(f"{bag} is outside the session's folder")


def _events(path: Path, out: Path) -> None:
    """As the event log of a session that goes on."""
    folder = path.parent / "session"
    folder.mkdir()
    (folder / EVENTS_FILE).write_bytes(path.read_bytes())
    log = EventLog.load(folder)
    log.add(Event(10**18, "note", "it goes on"))
    log.save()


def _settings(path: Path, out: Path) -> None:
    cls: type[Settings] = EstimatorSettings
    cls.from_json(path.read_bytes().decode(errors="replace"))


def _model(path: Path, out: Path) -> None:
    time = np.linspace(0, 1, 20)
    ReducedModel.load(path).simulate(StandardLinearSolid(), time, time)


def _dbc(path: Path, out: Path) -> None:
    """As the database of a shipped sensor mapping."""
    mapping = (SHIPPED / "robotous_rft.yaml").read_text(encoding="utf-8")
    copy = path.parent / "mapping.yaml"
    copy.write_text(mapping.replace("robotous_rft.dbc", path.name), encoding="utf-8")
    SensorMapping.load(copy)


def _sensor(path: Path, out: Path) -> None:
    """As the mapping of a sensor, beside the shipped database."""
    shutil.copy(SHIPPED / "robotous_rft.dbc", path.parent)
    SensorMapping.load(path)


CORPUS = Path(__file__).parent / "corpus"
SHIPPED = Path(finger_driver.__file__).parent / "data"
MODELS = Path(finger_model.__file__).parent / "data"


NEEDS = {".h5": "h5py", ".parquet": "pyarrow", ".xdf": "pyxdf"}
"""Ending of a file -> package without which it is not read."""


def corpus() -> dict[str, Path]:
    """Valid files by the name they are read under: the saved ones, and the shipped models."""
    saved = {path.name: path for path in CORPUS.iterdir()}
    saved = {
        name: path
        for name, path in saved.items()
        if path.suffix not in NEEDS or find_spec(NEEDS[path.suffix])
    }
    models = {"default": "model.npz", "population": "model-population.npz"}
    shipped = {name: MODELS / f"reduced_{of}.npz" for of, name in models.items()}
    return dict(sorted({**saved, **shipped}.items()))


READERS: dict[str, dict[str, Reader]] = {
    "bag": {
        "info": _bag("info", "--count"),
        "validate": _bag("validate"),
        "recover": _bag("recover", "-o", "OUT"),
        "anonymise": _bag("anonymise", "-o", "OUT"),
        "process": _bag("process", "-o", "OUT"),
        "trials": lambda path, out: load_trials(path),
        "hash": lambda path, out: bag_hash(path),
    },
    "metadata": {"info": _metadata, "hash": _metadata_hash},
    "mapping": {"mapping": lambda path, out: TopicMapping.load(path)},
    "parameters": {"parameter sets": lambda path, out: ParameterSets.load(path)},
    "plate": {"calibration": _plate, "attached": _attached},
    "material": {"material": lambda path, out: StandardLinearSolid.load(path)},
    "geometry": {"geometry": lambda path, out: Geometry.load(path)},
    "camera": {"camera_info": lambda path, out: CameraCalibration.load(path)},
    "rig": {"rig": lambda path, out: ParameterFile(path).sections},
    "settings": {"settings": _settings},
    "session": {"session": _session},
    "events": {"event log": _events},
    "checkpoint": {"checkpoint": _checkpoint},
    "force": {"table": lambda path, out: read_csv(path, ["time_s", "force_n"])},
    "table": {"columns": _columns},
    "fits": {"population": _fits},
    "readings": {"readings": _table},
    "sensor": {"sensor": _sensor},
    "database": {"sensor": _dbc},
    "netft": {"netft": lambda path, out: parse_netft(path.read_bytes())},
    "model": {"reduced model": _model},
    "image": {"area": _vision, "coarse area": _coarse},
}


def kind_of(path: Path) -> str:
    """Kind of a file by its name; raises ValueError for an unknown one."""
    kind = path.name.split(".")[0].split("-")[0]
    if kind not in READERS:
        raise ValueError(f"{path.name}: kinds are {', '.join(READERS)}")
    return kind
