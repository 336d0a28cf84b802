"""What the page of the paper's experiment says around its tables and figures."""

from __future__ import annotations

from collections.abc import Sequence

from binocal.experiments.guesses import N_GUESSES, NOISE_PX
from binocal.experiments.guesses import TABLE as STEPS
from binocal.experiments.options import ExperimentOptions
from binocal.experiments.page import Figure, Page, Part
from binocal.experiments.paper import CORRECT, LENGTH, left_out
from binocal.experiments.row import Row
from binocal.experiments.stability import SERIES, TABLE
from binocal.experiments.tables import markdown, tables_of

TIMED = "4"
PARTS = (
    Part(
        "3",
        "Table 3: calibration error",
        "Lengths that the calibrated rig measures on the half of the views that no method saw. The relative length error is the scale of "
        "the whole board minus one, RMS over the views: what calibration contributes. The error of a single square side is mostly the "
        "noise of its two corners; that of the bound's row is all that noise leaves possible. "
        "Boards as printed are bent by 0.3 mm and every corner is printed 0.05 mm (one sigma) off; every method is told the board as drawn, and "
        "lengths are compared with the board as it is. The bound is that of exact boards.",
        (
            Figure(LENGTH, "relative length error (%)", "Table 3: relative length error", "table-3.svg", is_log=True),
        ),
    ),
    Part(
        STEPS,
        "Steps 6 to 8: rotation and translation by the agent, from an uncalibrated guess",
        f"The cameras' own parameters come from vanishing points and are held; the rig starts at the data sheet's (parallel, 60 mm), or "
        f"turned and shifted from there ({N_GUESSES} guesses a seed, simulated corners with {NOISE_PX} px of noise). The agent chooses every "
        "step until the next one is shorter than three standard deviations over all unknowns; the classical loop ends it. A guard takes over "
        "after three rejected steps in a row, or where the distance left does not halve in four.",
        (
            Figure("iterations, all", "iterations", "From uncalibrated guesses: iterations", "steps.svg"),
            Figure("ended in the right minimum", "guesses (%)", "From uncalibrated guesses: the right minimum", "steps-right.svg"),
        ),
    ),
    Part(
        "figure 5",
        "Figure 5: iterations to convergence",
        "Iterations of each solver on the same corners, from the start that it makes for itself, to its own stop rule. The paper prints 30 "
        "for its algorithm and 70 for the others. OpenCV does not say how many it takes.",
        (Figure("iterations", "iterations", "Figure 5: iterations to convergence", "figure-5.svg", is_log=True),),
    ),
    Part(
        "figure 6",
        "Figure 6: parameters correct",
        "The share of a rig's parameters within three standard deviations of the Cramér-Rao bound and within a tolerance: 1 % of focal "
        "length and baseline, 1 % of the image's width for the principal point, 0.05 deg, 0.005 of a distortion coefficient.",
        (Figure(CORRECT, "parameters correct (%)", "Figure 6: parameters correct", "figure-6.svg"),),
    ),
    Part(
        TABLE,
        "Figure 7: stability",
        "The share of pairs of items that keep their order between two runs on different images, over all pairs of runs. The parameters "
        "keep it. The sizes of their errors (in standard deviations of the bound) cannot where a method reaches the bound: they are noise "
        "then, and the order of noise is chance, 50 %.",
        (
            Figure(SERIES["parameters"], "order kept (%)", "Figure 7: stability of the parameters", "figure-7.svg"),
        ),
    ),
    Part(
        "streets",
        "Streets: rotation and direction of the translation from natural images",
        "Of all pairs twice as many as are used are looked at, evenly over the drive, and those are used that together tell the pose best; the "
        "last table says what the choice costs. Simulated streets render no more than the pairs that are looked at. The bound's column is "
        "the standard deviation that the result states.",
    ),
    Part(
        "real boards",
        "Real boards: lengths on the half that was not used",
        "Random halves of each recording, one a seed. Nobody knows the true rigs; the boards' own shapes and pairs that were not taken at one "
        "moment are in these figures.",
        (
            Figure("held-out length error", "held-out length error (%)", "Real boards: held-out length error", "real.svg", is_log=True),
        ),
    ),
)  # fmt: skip


def paper_page(options: ExperimentOptions, rows: Sequence[Row]) -> Page:
    """The page of these rows."""
    no_row = "; ".join(f"{name} {why}" for name, why in left_out().items())
    text = (
        f"{options.n_images} rendered images of each set over {options.n_seeds} seeds from {options.seed}: {options.n_pairs} pairs each, the "
        "first half to calibrate from, the second to test on. Every method has the same corners. Medians over the seeds, least and "
        "greatest in brackets; what was refused is counted.",
        "What depends on the machine and the moment, table 4, is in times.md and results.json; this page is the same whenever the command is "
        "run with the same seed.",
        f"No row here: {no_row}. Every row, those of single parameters too, is in rows.csv and results.json.",
    )
    return Page("The paper's experiment", text, PARTS, tuple(row for row in rows if row.table != TIMED))


def times_text(rows: Sequence[Row]) -> str:
    """Table 4, as Markdown."""
    tables = tables_of(rows, TIMED)
    text = (
        "Seconds to the rig, every method in turn, with all threads; from images with the decoding of every file that is looked at. Medians of "
        "three solves. The paper prints its own algorithm's, on a machine that it does not name, and 7.1 to 49.5 s for the others."
    )
    return "\n\n".join(["# Table 4: time", text, *(markdown(table) for table in tables)]) + "\n"
