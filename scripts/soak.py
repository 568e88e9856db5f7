"""Record the full load of a rig for half an hour and count what was lost.

`make soak`; `python scripts/soak.py --seconds 60` for a shorter run. The result is printed and
written to bench/soak.json. Exit code 0 when nothing was lost, 1 otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "bench"))

import rig_load  # noqa: E402

from finger_common.files import atomic_write  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1800.0)
    parser.add_argument("--folder", type=Path, help="folder of the bag (about 14 MB/s)")
    parser.add_argument("--reliability", choices=["best_effort", "reliable"], default="best_effort")
    args = parser.parse_args()
    last = [0.0]

    def tell(seconds: float) -> None:
        if seconds - last[0] >= 30:
            last[0] = seconds
            print(f"  {seconds:.0f} of {args.seconds:.0f} s", flush=True)

    with tempfile.TemporaryDirectory(prefix="soak_", dir=args.folder) as folder:
        load = rig_load.measure(args.seconds, Path(folder), args.reliability, on_wait=tell)
    for topic, sent in load.sent.items():
        print(f"  {topic}: {sent} sent, {load.recorded[topic]} in the bag")
    print(
        f"{load.lost} lost, {load.reported_lost} reported by the recorder; recorder at "
        f"{load.cpu:.0%} of a core, {load.bag_bytes / load.seconds / 1e6:.1f} MB/s; "
        f"sender late by at most {load.late * 1e3:.0f} ms"
    )
    result = {**asdict(load), "lost": load.lost, "date": time.strftime("%Y-%m-%d")}
    with atomic_write(ROOT / "bench" / "soak.json") as file:
        json.dump(result, file, indent=1)
    return 0 if load.lost == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
