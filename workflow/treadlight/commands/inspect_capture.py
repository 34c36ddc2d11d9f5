"""List what a capture holds and what will be missing downstream.

Reads the manifest and hashes every image; decodes none.
"""

import argparse
from pathlib import Path

from treadlight.commands import common


def add_arguments(parser: argparse.ArgumentParser) -> None:
    common.add_stage_arguments(parser)
    parser.add_argument("capture", type=Path, help="capture folder")
    parser.add_argument("--out", type=Path, required=True, help="inventory.json to write")


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.archive.inventory import inventory

    def work() -> None:
        capture = read_capture(args.capture)
        frames = common.progress(capture.frames, f"{capture.id}: images looked at")
        digests = {frame.file: common.product_digest(capture.path(frame)) for frame in frames}
        store.write_json(args.out, inventory(capture, digests))

    return common.run_stage(
        args,
        inputs=[],
        outputs=[args.out],
        title="Inventory",
        source=args.capture.name,
        work=work,
    )
