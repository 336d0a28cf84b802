"""What the page of the paper's experiment says around its tables and figures."""

from __future__ import annotations

from collections.abc import Sequence

from binocal.experiments import colours, preparations
from binocal.experiments import target_distance as distance
from binocal.experiments.guesses import N_GUESSES, NOISE_PX
from binocal.experiments.guesses import TABLE as STEPS
from binocal.experiments.options import ExperimentOptions
from binocal.experiments.page import Figure, Page, Part
from binocal.experiments.paper import CORRECT, LENGTH
from binocal.experiments.row import Row
from binocal.experiments.stability import SERIES, TABLE
from binocal.experiments.tables import markdown, tables_of
from binocal.experiments.trained import N_STEPS, N_VIEWS
from binocal.experiments.trained import TABLE as TRAINING

TIMED = "4"
PARTS = (
    Part(
        "3",
        "Table 3: calibration error",
        "Lengths that the calibrated rig measures on the half of the views that no method saw. The relative length error is the scale of "
        "the whole board minus one, RMS over the views: what calibration contributes. The error of a single square side is mostly the "
        "noise of its two corners; that of the bound's row is all that noise leaves possible. "
        "Boards as printed are bent by 0.3 mm and every corner is printed 0.05 mm (one sigma) off; every method is told the board as drawn, and "
        "lengths are compared with the board as it is. The bound is that of a board of which this much is known, not where each corner is.",
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
        TRAINING,
        "Steps 1 to 6 with an agent of its own, and figure 5: the value function",
        f"The first half of {N_VIEWS} views trains the agent for {N_STEPS} steps, with rewards that look at no truth; on the second it starts at "
        f"guesses up to 20 deg and 30 % off. The loss is the critic's; the paper takes its fall for convergence. What it is worth shows "
        "the critic's value beside the returns that followed, and what counts are the held-out iterations.",
        given={"training.svg": "Figure 5: the value function, soft and hard targets"},
    ),
    Part(
        "figure 5",
        "Figure 5: iterations to convergence",
        "Iterations of each solver on the rendered boards' corners, of all its stages, from the start that it makes for itself, to its own "
        "stop rule. OpenCV does not say how many it takes. The other tables and the curves are of simulated corners with six times the "
        "noise. The curves are the mean square of the residuals after every iteration; of a method that "
        "works in stages, those of its present stage (with a gap where a stage begins); `from-guess` begins at the data sheet's rig. What the "
        "paper calls converged is read as 95 % of the loss's fall; until within 5 % of the last loss takes longer. The paper prints 30 for "
        "its algorithm and 70 for [8], [11] and [12]; it does not say what an iteration is.",
        (Figure("iterations", "iterations", "Figure 5: iterations to convergence", "figure-5.svg", is_log=True),),
        {"figure-5-loss.svg": "Figure 5: the loss of every solver by iteration"},
    ),
    Part(
        "figure 6",
        "Figure 6: parameters correct",
        "The share of a rig's parameters within three standard deviations of the Cramér-Rao bound and within a tolerance: 1 % of focal "
        "length and baseline, 1 % of the image's width for the principal point, 0.05 deg, 0.005 of a distortion coefficient. Of boards as "
        "printed the bound knows how large bow and print error are and not where each corner is: their print's scale is off by chance, and the "
        "baseline with it. By the bound of a board that is known exactly they are counted as well.",
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
        "heterogeneous",
        "A colour and a thermal camera",
        "The paper's related work [9] on its own input: 12 rendered pairs, 1280x720 in colour beside 640x480 with ink lighter than paper.",
    ),
    Part(
        "wide",
        "Thermal cameras of 180 and 210 degrees",
        "The paper's related work [11] on its own input: 12 rendered pairs, 640x512, a third of the contrast. The cited work prints its "
        "binocular mean reprojection error beside that of the mean of the views' poses, of other cameras and corners.",
    ),
    Part(
        "rectangles",
        "Cameras that turn before a rectangle of unknown size",
        "The paper's related work [10] on its own input: RMS over the pairs after the first, each as it was known when it came. The cited "
        "work's figures are of its own set-up.",
    ),
    Part(
        "zoom",
        "Zoom lenses",
        "The paper's related work [12] on its own input: lengths and rectified rows at the calibrated settings and between them, by the curves "
        "with the network and by plain interpolation of the calibrations.",
    ),
    Part(
        "streets",
        "Streets: rotation and direction of the translation from natural images",
        "Pairs are glanced at, evenly over the drive, twelve times as many as are used if there are so many, and those are used that together "
        "tell the pose best, as by `recalibrate`; tables say which, and what the choice costs and gains in standard deviations. Of simulated "
        "streets twice as many pairs are rendered as are used; the measured set's are six, seen by the rig of the paper's table 2. The "
        "bound's column is the standard deviation that the result states.",
    ),
    Part(
        distance.TABLE,
        "Target distance: depth and length",
        f"The paper leaves it open. A plane that fills {100 * distance.FIELD:.0f} % of what both cameras see at the distance, after a "
        f"calibration from {distance.N_PAIRS} views ({distance.NOISE_PX} px a corner). Lengths are the plane's width and height. The "
        "bound's column is the standard deviation that each calibration predicts of itself (`calibration.depth_sigma`; for lengths, rigs "
        "drawn from its covariance).",
        (
            Figure("depth error, exact matches", "depth error (%)", "Depth error by distance", "distance.svg", is_log=True),
        ),
    ),
    Part(
        preparations.TABLE,
        "Filter and stronger edges",
        f"The paper filters its images and strengthens their edges; `--preprocess` does so. The same {preparations.N_PAIRS} pairs a seed "
        "with and without, at several levels of noise (grey levels of 255) and of light.",
        (
            Figure("corner error", "corner error (px)", "Corners with and without the paper's preparation", "preparation.svg"),
        ),
    ),
    Part(
        colours.TABLE,
        "Colour channels: a simulated lens",
        f"Colour images without and with {colours.ABERRATION_PX} px of lateral chromatic aberration in their corners (red outward, blue "
        "inward); the true rig is green's. Rigs of another colour are right for that colour; the last figure says what they do to matches "
        "in green.",
    ),
    Part(
        colours.REAL,
        "Colour channels: real recordings",
        "Random halves, one a seed, each channel tested in itself.",
        (
            Figure("held-out row error", "held-out row error (px)", "Real recordings by channel", "colours.svg", is_log=True),
        ),
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
    others = (
        "`rectangles` and `zoom` work from other evidence than boards before one rig and have parts of their own. "
        if not options.is_quick
        else "A quick run leaves out the related work on its own input (`heterogeneous`, `wide-field`, `rectangles`, `zoom`), agents that "
        "are trained, the preparation of images, simulated colour, and the streets of Cityscapes and of the measured set; KITTI's has "
        "fewer pairs. "
    )
    text = (
        f"{options.n_images} rendered images of each set over {options.n_seeds} seeds from {options.seed}: {options.n_pairs} pairs each, the "
        "first half to calibrate from, the second to test on. Every method has the same corners, but `opencv, its own corners`: cv2's finder "
        "and `cornerSubPix`. Medians over the seeds, least and "
        "greatest in brackets; what was refused is counted.",
        "What depends on the machine and the moment, table 4, is in times.md and results.json; this page is the same whenever the command is "
        "run with the same seed.",
        f"{others}A bound is the median over the seeds that gave a result; the bound's own row is RMS over rigs that scatter about the "
        "truth as the bound says. Every row, those of single "
        "parameters too, is in rows.csv and results.json.",
    )
    return Page("The paper's experiment", text, PARTS, tuple(row for row in rows if row.table != TIMED))


def times_text(rows: Sequence[Row]) -> str:
    """Table 4, as Markdown."""
    tables = tables_of(rows, TIMED)
    text = (
        "Seconds to the rig, every method in turn, with all threads; from images with the decoding of every file that is looked at. The "
        "measured set's boards are half of 10 mm, half of 20 mm squares, before six streets, and a method calibrates from each (medians of "
        "three solves of both). All methods have the same corners, but `opencv, its own corners`: cv2's finder and `cornerSubPix`. Streets "
        "that have fewer pairs than the set has images for are repeated for the time alone. The paper's figures are of a machine that it does "
        "not name; its other methods need boards, so streets have no row of them here."
    )
    return "\n\n".join(["# Table 4: time", text, *(markdown(table) for table in tables)]) + "\n"
