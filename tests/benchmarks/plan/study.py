"""make bench-plan: an archive of 1,000 captures of 200 sections and 17 views of 16 LEDs.

How long and in how much memory `snakemake -n` plans it, when it sees the archive for the first
time and again, when all is done, and with one capture more; and that one capture whose job fails
leaves the others. Images are tiny, their number is true. Ends with one line of JSON.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

from crowd import Crowd, Run, Size, jobs_of_one_more

_MAX_S, _MAX_BYTES = 90, 2 << 30


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=Size.captures)
    parser.add_argument("--out", type=Path, default=Path("build/bench-plan"))
    args = parser.parse_args()
    crowd = Crowd(args.out.resolve(), replace(Size(), captures=args.captures))
    say(f"writing {args.captures} captures of {crowd.size.images} images")
    crowd.write()
    plans = {name: plan(crowd, name) for name in ("first", "second")}
    say("every product, hollow")
    crowd.pretend()
    plans["done"] = plan(crowd, "done")
    crowd.add(args.captures)
    plans["one_more"] = plan(crowd, "one_more")
    say("one capture that fails among the others")
    crowd.write()
    blocked = crowd.block(args.captures // 2)
    status = crowd.snakemake(*crowd.inventories()).status
    found = {
        "captures": args.captures,
        "images": args.captures * crowd.size.images,
        "plans": {name: figures(run) for name, run in plans.items()},
        "one_more_plans_its_own_jobs": plans["one_more"].jobs == jobs_of_one_more(crowd.size),
        "failing_leaves": args.captures - len(crowd.uninspected()),
    }
    good = (
        all(run.wall_s <= _MAX_S and run.peak_bytes <= _MAX_BYTES for run in plans.values())
        and plans["done"].jobs == {}
        and found["one_more_plans_its_own_jobs"]
        and status == 1
        and crowd.uninspected() == [blocked]
    )
    print(json.dumps(found | {"good": good}))
    return 0 if good else 1


def plan(crowd: Crowd, name: str) -> Run:
    run = crowd.snakemake("-n", "--quiet", "rules")
    if run.status != 0:
        sys.exit(run.output[-3000:])
    say(f"{name} plan: {figures(run)}")
    return run


def figures(run: Run) -> dict[str, float]:
    return {
        "wall_s": round(run.wall_s, 1),
        "processor_s": round(run.cpu_s, 1),
        "peak_mib": run.peak_bytes >> 20,
        "jobs": sum(run.jobs.values()),
    }


def say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
