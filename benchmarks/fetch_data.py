"""Fetches the public image sets of the README's table from where their owners publish them: ``python fetch_data.py FOLDER``.

Only sets whose licence allows it; each file is checked against the digest of the set that the table was made with. Point
``BINOCAL_DATA`` at the folder. Nothing is fetched twice, and a set is there in full or not at all.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import sys
import tempfile
import urllib.error
import urllib.request
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

TIMEOUT_S = 60


@dataclass(frozen=True)
class ImageSet:
    """Files of one recording. ``files`` are paths below ``url``, which keep their last parts in the set's folder."""

    name: str
    owner: str
    licence: str
    url: str
    files: tuple[str, ...]
    digest: str
    """SHA-256 over ``name``, NUL, SHA-256 of the content, newline, of every file in the order of their names."""


def _both(pattern: str, numbers: Iterable[int]) -> tuple[str, ...]:
    return tuple(pattern.format(side=side, n=n) for side in ("left", "right") for n in numbers)


SETS = (
    ImageSet(
        "opencv_bouguet",
        "OpenCV (J.-Y. Bouguet's images)",
        "Apache-2.0",
        "https://raw.githubusercontent.com/opencv/opencv/4.x/samples/data/",
        _both("{side}{n:02}.jpg", (*range(1, 10), *range(11, 15))),
        "88d5096fa4d3135ac7fde118885d0da18cd61fc3e24fa1fa81db711b5312d7fb",
    ),
    ImageSet(
        "boof_bumblebee2_chess",
        "BoofCV (P. Abeles)",
        "CC BY 4.0",
        "https://raw.githubusercontent.com/lessthanoptimal/BoofCV-Data/SNAPSHOT/calibration/stereo/Bumblebee2_Chess/",
        _both("{side}{n:02}.jpg", range(1, 12)),
        "9f1a03d11c8daca228686ac86a59091e42a1958491db006be762d462c791896f",
    ),
    ImageSet(
        "rursprung_charuco",
        "fhgr-stereo-vision (R. Ursprung and others)",
        "GPL-3.0",
        "https://raw.githubusercontent.com/rursprung/fhgr-stereo-vision/main/resources/calibration/v1/",
        _both("{side}/{n:03}.jpg", range(30)),
        "2296ed379dd4705ce6a7297b5637fcc1bf4f41e10a9d5a10ba2bf3f8f29a8801",
    ),
    ImageSet(
        "stereopi_fisheye",
        "StereoPi (realizator)",
        "GPL-3.0",
        "https://raw.githubusercontent.com/realizator/stereopi-fisheye-robot/master/pairs/",
        _both("{side}_{n:02}.png", (*range(1, 22, 2), *range(24, 51, 2))),
        "6bdaa5a7b3f2c7f49cd7d435e112dacf864684550304c2d2eff8f66f47fc4bbd",
    ),
)

NOT_FETCHED = {
    "presentcjn_cb11x8": "MIT; ask its author for the images",
    "sourishg_webcam_640, sourishg_webcam_270x180": "no licence stated (github.com/sourishg/stereo-calibration)",
    "nico_tablet_a": "no licence stated",
    "barry_swapped": "no licence stated",
    "aix_sidebyside": "no licence stated (github.com/andrea-abascal/stereo_vision_AIX)",
}


def digest_of(contents: dict[str, bytes]) -> str:
    """See :attr:`ImageSet.digest`."""
    total = hashlib.sha256()
    for name in sorted(contents):
        total.update(name.encode() + b"\0" + hashlib.sha256(contents[name]).hexdigest().encode() + b"\n")
    return total.hexdigest()


def fetch(images: ImageSet, folder: Path) -> str:
    """One set into its folder below ``folder``; what became of it, in words.

    Raises:
        OSError: A file cannot be had, or the files are not those of the table; nothing is left behind.
    """
    target = folder / images.name
    if target.exists():
        return "is there already"
    contents = {}
    for name in images.files:
        try:
            with urllib.request.urlopen(images.url + name, timeout=TIMEOUT_S) as answer:
                contents[name] = answer.read()
        except (urllib.error.URLError, TimeoutError) as error:
            raise OSError(f"{images.url + name}: {getattr(error, 'reason', error)}") from None
    if digest_of(contents) != images.digest:
        raise OSError(f"{images.url}: the files are not those that the table was made with")
    folder.mkdir(parents=True, exist_ok=True)
    aside = Path(tempfile.mkdtemp(prefix=f".{images.name}.", dir=folder))
    try:
        for name, content in contents.items():
            (aside / name).parent.mkdir(parents=True, exist_ok=True)
            (aside / name).write_bytes(content)
        aside.chmod(0o755)
        aside.rename(target)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return f"{len(contents)} files ({images.owner}, {images.licence})"


def main(arguments: list[str] | None = None, sets: tuple[ImageSet, ...] = SETS) -> int:
    """The command; 1 if a set could not be had."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where the sets go, one folder each")
    folder = parser.parse_args(arguments).folder
    failed = 0
    for images in sets:
        try:
            print(f"{images.name}: {fetch(images, folder)}")
        except OSError as error:
            failed += 1
            print(f"{images.name}: not fetched: {error}", file=sys.stderr)
    for name, reason in NOT_FETCHED.items():
        print(f"{name}: not fetched: {reason}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
