"""Render an archive of captures with known truth: one calibration and worn, remounted tires.

OUT gets one folder per capture, as capture-format.md says, with truth/. A folder that holds
the same archive already is left as it is; an interrupted run is taken up again. The same
options give the same bytes on any number of cores.
"""

import argparse
import sys
import time
from pathlib import Path

from treadlight.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("out", type=Path, metavar="OUT", help="the archive's folder")
    parser.add_argument(
        "--preset",
        default="demo",
        choices=("demo", "tiny", "sample"),
        help="demo: whole turn, three mileages; tiny: a sector, two mileages, seconds; sample: a"
        " sector of 512x768 images (default: demo); the options below change it",
    )
    parser.add_argument("--size", metavar="WxH", help="image size, pixels, such as 192x288")
    parser.add_argument("--sector-deg", type=float, help="part of the turn; 360 is all of it")
    parser.add_argument("--sections", type=int, help="laser sections over the sector or turn")
    parser.add_argument("--views", type=int, help="fields of view under the LEDs")
    parser.add_argument("--leds", type=int, help="number of LEDs")
    parser.add_argument("--mileages", metavar="A,B,..", help="miles, ascending")
    parser.add_argument("--tires", type=int, help="number of tires")
    parser.add_argument("--seed", type=int, help="another seed, another rig and tire")
    parser.add_argument("--scan", choices=("rows", "columns"), help="how the camera is turned")
    parser.add_argument("--wear", type=float, metavar="MM", help="mean wear in 100 miles, mm")
    parser.add_argument("--force", action="store_true", help="render all of it anew")


def run(args: argparse.Namespace) -> int:
    from treadlight.simulate import preset, write_archive

    settings = preset(
        args.preset,
        size_px=_numbers(args.size, "x", "size", int),
        sector_deg=args.sector_deg,
        sections=args.sections,
        views=args.views,
        leds=args.leds,
        mileages=_numbers(args.mileages, ",", "mileages", float),
        tires=args.tires,
        seed=args.seed,
        scan=args.scan,
        wear_mm_per_100mi=args.wear,
    )
    if not write_archive(settings, args.out, force=args.force, say=_sayer()):
        print(f"{args.out}: there already", file=sys.stderr)
    return 0


def _numbers(text: str | None, separator: str, name: str, kind: type) -> tuple | None:
    if text is None:
        return None
    try:
        values = tuple(kind(part) for part in text.split(separator))
    except ValueError:
        values = ()
    if not values or (name == "size" and len(values) != 2):
        example = "192x288" if name == "size" else "100,200,300"
        raise ConfigError(f"--{name} is {text!r}. It must look like {example}.")
    return values


def _sayer(every_s: float = 5.0):
    """Says at most one line every few seconds."""
    last = -every_s

    def say(line: str) -> None:
        nonlocal last
        if time.monotonic() - last >= every_s:
            print(line, file=sys.stderr, flush=True)
            last = time.monotonic()

    return say
