"""Cases of experiments that cost nothing: the evidence is the seed."""

from __future__ import annotations

from dataclasses import dataclass

from binocal.errors import SceneError
from binocal.experiments.case import Made, Sample
from binocal.experiments.row import Measured
from binocal.simulation import table2_rig


@dataclass(frozen=True)
class Fails:
    """Fails with one seed, which is the sample's evidence."""

    label: str = "fails"
    seed: int = 1

    def __call__(self, sample):
        if sample.evidence == self.seed:
            raise SceneError("not with\nthis one", 0, 1)
        return (Made(table2_rig()),)


@dataclass(frozen=True)
class Several:
    label: str = "several"

    def __call__(self, sample):
        return [Made(table2_rig()), Made(table2_rig())]


def make(seed):
    return Sample(seed, table2_rig())


def measure(made, sample):
    return [Measured("length", "mm", 10.0 + sample.evidence, 2.0), Measured("share", "%", 50.0, table="figure 6")]
