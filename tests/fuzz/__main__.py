"""Give every reader damaged and hostile files, each in a process of its own with limits.

    python tests/fuzz --cases 20000 --seed 1       mutated files of the corpus
    python tests/fuzz --cases 20000 --only 1000017 one of these cases again
    python tests/fuzz --files bag.mcap plate.yaml  these files as they are

A case passes when the reader ends with success or one sentence, within 10 s of processor time and
500 MB, and writes nothing but its output. Prints JSON; exit code 1 when a case fails. Files of
failed cases are kept in --keep; --record keeps the report, from which scripts/faults.py writes
docs/faults.md.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

# A forked process may not use threads of GNU OpenMP, once its parent did.
os.environ["NUMBA_THREADING_LAYER"] = "workqueue"

import cv2
import mutate
import numpy as np
from readers import READERS, Reader, corpus, kind_of

from finger_common.cli import one_line
from finger_common.errors import FingerError
from finger_common.files import atomic_write

RECORDED = Path(__file__).with_name("recorded.json")
CPU_SECONDS, MEGABYTES = 10, 500
BATCH = 40
"""Files that one forked process reads."""

Job = tuple[Path, str, dict[str, Any]]
"""A file, the name of its reader, and what the report says of the case."""

SENTENCE = 1200
"""Characters of the longest sentence; names of files are in it."""


def outcome_of(reader: Reader, path: Path, out: Path) -> tuple[str, str]:
    """How a reader ends: "success", "refused" or "FAILED", and what it says."""
    try:
        code = reader(path, out)
    except FingerError as error:
        text = one_line(error)
        return ("refused" if str(error) and len(text) < SENTENCE else "FAILED"), text
    except BaseException:
        return "FAILED", traceback.format_exc()
    if isinstance(code, int) and code not in (0, 1, 2):
        return "FAILED", f"exit code {code}"
    if code == 2 and out.exists():
        return "FAILED", "refused, and yet the output exists"
    return ("refused" if code == 2 else "success"), ""


def attempt(path: Path, name: str) -> dict[str, Any]:
    """Run one reader on a file in this process; what it printed decides too."""
    out = path.parent / "out"
    before = {p.name for p in path.parent.iterdir()}
    began = time.process_time()
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        result, message = outcome_of(READERS[kind_of(path)][name], path, out)
        sys.stdout.flush()
        sys.stderr.flush()
        said.seek(0)
        printed = said.read().decode(errors="replace")
    if "Traceback" in printed:
        result, message = "FAILED", printed
    elif result == "refused" and not message:
        # Lines that begin with the bag's name tell its progress.
        lines = [x for x in printed.splitlines() if not x.startswith(f"{path.name}:")]
        message = "\n".join(lines)
        if "\n" in message or not message or len(message) > SENTENCE:
            result = "FAILED"
    beside = {p.name for p in path.parent.iterdir()} - before
    if not beside <= {"out", "bag", "session", "mapping.yaml", "robotous_rft.dbc"}:
        result, message = "FAILED", f"wrote {sorted(beside)}"
    for name_beside in beside:
        entry = path.parent / name_beside
        shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
    cpu = time.process_time() - began
    return {"reader": name, "outcome": result, "text": message[-3000:], "cpu": round(cpu, 2)}


def run_jobs(jobs: list[Job]) -> list[dict[str, Any]]:
    """Results of readers on files, in one forked process; one after the other where that ends
    early or takes too much.
    """
    with tempfile.TemporaryFile() as answers:
        process = os.fork()
        if process == 0:
            try:
                for path, name, _ in jobs:
                    signal.setitimer(signal.ITIMER_PROF, 1.5 * CPU_SECONDS)
                    os.write(answers.fileno(), json.dumps(attempt(path, name)).encode() + b"\n")
            finally:
                os._exit(0)
        _, status, used = os.wait4(process, 0)
        answers.seek(0)
        results = [json.loads(line) for line in answers]
    memory = used.ru_maxrss / 1024
    ended = os.WIFSIGNALED(status)
    if len(jobs) > 1 and (ended or len(results) < len(jobs) or memory > MEGABYTES):
        return [result for job in jobs for result in run_jobs([job])]
    if not results:
        why = signal.Signals(os.WTERMSIG(status)).name if ended else "no answer"
        results = [{"reader": jobs[0][1], "outcome": "FAILED", "text": why, "cpu": used.ru_utime}]
    for result, (path, _, more) in zip(results, jobs):
        if result["cpu"] > CPU_SECONDS or memory > MEGABYTES:
            result["outcome"] = "FAILED"
        result.update(file=path.name, megabytes=round(memory), **more)
    return results


def warm_up(kinds: set[str]) -> None:
    """Import and compile once what the forked processes need."""
    cv2.setNumThreads(1)
    for file, path in corpus().items():
        kind = kind_of(Path(file))
        if kind not in kinds:
            continue
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(shutil.copy(path, Path(folder, file)))
            for name, reader in READERS[kind].items():
                kept = [os.dup(1), os.dup(2)]
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, 1)
                os.dup2(null, 2)
                result, text = outcome_of(reader, copy, copy.parent / "out")
                for number, handle in enumerate(kept, 1):
                    os.dup2(handle, number)
                    os.close(handle)
                os.close(null)
                if result != "success":
                    raise SystemExit(f"{file}, {name}: {result}: {text}")
                shutil.rmtree(copy.parent / "out", ignore_errors=True)


def mutated(path: Path, seed: int) -> tuple[str, bytes]:
    """Name of the change and the changed content of a file of the corpus."""
    rng = np.random.default_rng(seed)
    changes = mutate.BY_ENDING[path.suffix]
    change = changes[int(rng.integers(len(changes)))]
    return change.__name__, change(path.read_bytes(), rng)


def cases(number: int, seed: int) -> list[tuple[str, Path, int]]:
    """Names and files of the corpus, in turn, with the seeds of their mutations.

    A seventh of them are bags.
    """
    found = list(corpus().items())
    bags = [(name, path) for name, path in found if path.suffix == ".mcap"]
    turns = found + bags * (len(found) // (6 * len(bags)) - 1)
    return [(*turns[i % len(turns)], seed * 1_000_000 + i) for i in range(number)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])  # type: ignore[union-attr]
    parser.add_argument("--cases", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="one case: its number, as in the report")
    parser.add_argument("--files", type=Path, nargs="*", default=[])
    parser.add_argument("--few", action="store_true", help="two readers a case, in turn")
    parser.add_argument("--record", action="store_true", help="keep the report for docs/faults.md")
    parser.add_argument("--keep", type=Path, help="folder for the files of failed cases")
    args = parser.parse_args()
    began = time.time()
    results: list[dict[str, Any]] = []
    warm_up({kind_of(f) for f in args.files} or set(READERS))
    chosen: list[tuple[str, Path, int | None]] = [(f.name, f, None) for f in args.files]
    chosen = chosen or [*cases(args.cases, args.seed)]
    with tempfile.TemporaryDirectory(prefix="fuzz") as folder:
        for begin in range(0, len(chosen), BATCH):
            jobs: list[Job] = []
            for number, (name, path, seed) in enumerate(chosen[begin : begin + BATCH]):
                if args.only and seed != args.only:
                    continue
                case = Path(folder) / str(number) / name
                case.parent.mkdir()
                more: dict[str, Any] = {}
                if seed is None:
                    shutil.copy(path, case)
                else:
                    change, content = mutated(path, seed)
                    case.write_bytes(content)
                    more = {"case": seed, "change": change}
                names = list(READERS[kind_of(case)])
                if seed is not None and args.few:
                    names = [names[(seed + k) % len(names)] for k in range(min(2, len(names)))]
                jobs += [(case, name, more) for name in names]
            for (case, _, _), result in zip(jobs, run_jobs(jobs) if jobs else []):
                results.append(result)
                if result["outcome"] == "FAILED" and args.keep:
                    args.keep.mkdir(parents=True, exist_ok=True)
                    kept = f"{case.stem}-{result.get('case', '')}{case.suffix}"
                    shutil.copy(case, args.keep / kept)
                    print(json.dumps(result), file=sys.stderr, flush=True)
            shutil.rmtree(folder)
            Path(folder).mkdir()
    table = Counter((kind_of(Path(r["file"])), r["reader"], r["outcome"]) for r in results)
    failed = [r for r in results if r["outcome"] == "FAILED"]
    report = {
        "cases": len(chosen),
        "seed": args.seed,
        "runs": len(results),
        "seconds": round(time.time() - began),
        "longest": max((r["cpu"] for r in results), default=0.0),
        "most_megabytes": max((r["megabytes"] for r in results), default=0),
        "outcomes": {", ".join(key): count for key, count in sorted(table.items())},
        "failed": failed,
        "results": results if args.files else [],
    }
    if args.record:
        with atomic_write(RECORDED) as file:
            json.dump(report, file, ensure_ascii=False, indent=1)
            file.write("\n")
    print(json.dumps(report, indent=1))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
