"""Writes docs/findings/: a page for every code of a finding, and the index. Run by ``make docs``; a test holds them in step."""

from __future__ import annotations

import string
import textwrap
from pathlib import Path

from binocal.acceptance import RULES
from binocal.findings import KINDS, FindingKind, Severity

FOLDER = Path(__file__).with_name("findings")
METHOD = Path(__file__).with_name("method.md")
BEGIN, END = "<!-- rules: written by make_findings.py -->", "<!-- end of rules -->"
WIDTH = 100

HEADINGS = {
    Severity.REFUSAL: "Refusals: there is no result",
    Severity.WARNING: "Warnings: there is a result with a weakness",
    Severity.NOTE: "Notes: left out, repaired, or measured along",
}

EXPLANATIONS = {
    "corners-do-not-fit": """
        The solve ended, but its residuals are a noticeable part of the distance between neighbouring corners. No detector is
        that bad: the corners belong to another board, are numbered in another order in many views, or left and right images
        were taken at different moments.""",
    "too-many-outliers": """
        The robust loss lets go of corners that contradict the rest. When it had to let go of a third of them, what is left may
        be any of several explanations, and which one it is was decided by chance.""",
    "focal-length-undetermined": """
        A board parallel to the image plane looks the same from twice the distance at twice the focal length. Only tilted
        boards tell the two apart, and different tilts tell more. The refusal comes at 5 %, where distances measured by the
        rig would be wrong by as much; parallel views are refused earlier, since their small standard deviation rests on the
        lens model alone.""",
    "prior-contradicted": """
        The views are fitted once with the prior and once without it. How much worse the fit becomes, and how far the rig is
        moved from the prior, is compared with the noise and with the prior's standard deviations. At five standard deviations
        over all its parameters one of the two is wrong: the rig was dropped, refocused or mounted anew, or the prior is of
        another rig. What is held exactly counts as well.""",
    "halves-disagree": """
        Every other view goes into one of two halves, each is calibrated alone, and what the first sees the second measures.
        The difference of depth is compared with what both state, over the image, at the boards' distance and at three times
        that. Three standard deviations (RMS) are far beyond chance and beyond any sound recording: halves of nine real ones
        reach 1.9. What the views disagree about is then larger than what they have in common.""",
    "halves-agree": """
        As for halves that disagree, but within what their standard deviations allow. The differences are those of half of the
        views: the whole is better by about the root of two.""",
    "halves-undetermined": """
        Two halves need at least four views each, and each of them must determine the rig: a set of few views, or one that
        rests on a few of its views, cannot be tested so.""",
    "lens-model-misfits": """
        What residuals point outwards by is fitted as a free function of the distance from the principal point, to all views but
        a block, and taken from that block's corners. If the rectified rows of the blocks fall clearly (by a twentieth of their
        squares and by three standard errors), the lens does what its model cannot. Rows are then wrong where no board was
        seen, by more than the standard deviations say.""",
    "lens-model-suffices": """
        As for a lens that its model cannot follow, but a free profile would predict views left out no better.""",
    "rays-everywhere": """
        The distortion moves points outwards all the way to the corners of both images, so that every pixel belongs to one
        direction.""",
    "residuals-correlated": """
        Residuals of neighbouring corners of an image should be independent. Where they are alike (a lens that its model does
        not follow, a board that bends from view to view, corners measured from the same pixels), fewer corners tell of the
        rig than were counted. Usually what views have in common shows, and the standard deviations count it; here they do
        not.""",
    "residuals-checked": """
        Residuals of neighbouring corners of an image should be independent. Real ones are alike to some degree; where the
        standard deviations were widened for what views have in common, that is counted.""",
    "corners-not-of-rig": """
        A report looks beside the rig's file for the corners that it was made from, and computes from them what the file says of
        its views. A file with the same views in which the figures differ means that one of the two was changed afterwards:
        calibrated anew without writing the other, or edited by hand. Which one, the figures cannot tell.""",
    "rig-file-changed": """
        Where the cameras did not see the board at one moment, each view has a right pose of its own, which fits its corners
        whatever R and T are. A calibration ends where the deviations of these poses balance, to 0.26 standard errors on the
        sets that were measured; R turned by 0.05 deg by hand leaves 3 to 12.""",
    "rig-does-not-fit": """
        Each view's board is fitted to both images under the rig, and to each image alone. A rig that is merely less certain
        than it says leaves nearly the same; three times as much, beyond what the pair left when it was calibrated, is
        no matter of standard deviations.""",
    "rows-off": """
        A rig that states no standard deviations, such as one of OpenCV's files, cannot be compared with new images in their
        units. What the rectified rows of all views are off by alike (a constant and a slope along both axes of the image) can
        be separated from what differs between the views: it is the rig's own error, whatever the noise. It is named where chance
        makes it once in ten thousand times or less, and where it is larger than 0.1 px and than everything else in the rows.""",
    "rig-disagrees": """
        New images of a board are solved with the rig as a wide prior, and what they say is compared with the rig in units of
        both standard deviations, in every direction of which they tell anything. By chance a rig that has not changed is
        said to have once in ten thousand times. The change that explains most is named: a camera that turned against the
        other, was shifted or refocused, or whose image was shifted (a turn and a shift of the image look alike). Which of the
        two cameras it was, corners cannot always tell.""",
    "prior-doubtful": """
        As for a contradicted prior, but less: by chance it happens once in ten thousand calibrations of a rig that has not
        changed. On real rigs stated standard deviations are often too small, which shows in the same way.""",
    "principal-point-impossible": """
        The principal point is where the optical axis meets the image; lenses are mounted within a few percent of the middle.
        A solve that puts it far away, and is sure of it, has explained something else by it: boards that stayed in one part
        of the image, or images that were cropped after they were taken. Crop-free images or more varied views help.""",
    "zoom-off-curve": """
        Every setting but the outer two is left out in turn, and its own calibration compared with the curves through the others
        (standard deviations of both, RMS over the rig's quantities); and a zoom's focal length grows, or falls, from setting to
        setting. A setting with another one's number or images does neither. Curves that bend more than the settings show do
        the same: more settings there help. The stated standard deviations are widened by what was seen.""",
    "lens-of-another-kind": """
        `wide-field` solves for lenses of 110 to 220 degrees. Where every corner lies within 60 degrees of the axes, the corners
        are fitted with an ordinary model as well. Where that is not decisively worse (Bayesian information criterion), what
        both rigs differ by counts as one standard deviation; a warning says so from two on, or where the ordinary model is
        decisively better.
        A misfit that differs from view to view is then not taken for cameras that were not triggered together.""",
    "rectangle-outside-image": """
        The images have the size of the prior's cameras, and a corner was measured in an image, so it cannot lie outside. Rows
        given before columns do this to nearly every set, and are named.""",
    "rectangles-misread": """
        The pairs are solved with attitudes that hardly count. Where the corners then miss their rectangle by more than a pixel and
        0.5 % of its extent, the first eight pairs are read with left and right exchanged, with x and y exchanged, and each with a
        rectangle of its own. A reading that leaves less than half is named; nothing is exchanged silently.""",
    "attitudes-contradict-corners": """
        The pairs are solved a second time with attitudes that hardly count (10 degrees). In the median pair the angles found so
        lie as far from the attitudes as both standard deviations together allow: 0.7 to 1.3 times in sound sets. At three times
        the attitudes are refused, for the rig would follow them, with standard deviations that mean nothing. Radians for degrees,
        exchanged sides, exchanged yaw and pitch, and opposite signs are looked for and named.""",
    "rectangles-do-not-fit": """
        A pair whose corners, attitudes and rectangle contradict each other is left out by name. Where most are, those that are
        left may agree by chance; and a noise of 2 % of the rectangle's extent is no measurement of its corners.""",
    "attitudes-less-certain": """
        As for attitudes that contradict the corners, at 1.5 to 3 times what both standard deviations allow, over eight pairs or
        more. The rig is found with the attitudes counting as little as they agree, and its standard deviations say so.""",
    "rotation-undetermined": """
        The rotation between the cameras is known worse than one degree: rows of a rectified pair would not match. Usually the
        board was small in both images, or stayed in one place.""",
    "translation-undetermined": """
        The translation between the cameras is known worse than a fifth of the baseline, so depths would be wrong by as much.
        Usually the board stood in nearly the same pose in all views.""",
    "not-converged": """
        The solver stopped at its limit of iterations. Either some parameters are so weakly determined that the cost hardly
        changes along them, or the start was wrong; in both cases the numbers where it stopped mean nothing.""",
    "views-of-one-pose": """
        A board held before the cameras, or a laptop before the board: the views differ by the trembling of a hand. They are
        compared with the view in their midst, by the angle between the board's poses and by how far its corners moved, in
        shares of the board's own size in the image. Within 12 degrees and 12 % of one view there is one pose, whatever its
        tilt; the refusal comes if the solve found no minimum or leaves a focal length open by more than 1 %.""",
    "board-not-found": """
        The commonest reason is given, and how many images have it; the list above the message has every image. Some of the
        images were looked at again for any other board, and show none that is recognised.""",
    "board-is-another": """
        Where no image shows the board, or few do, some of the others are looked at again for a chessboard, a ChArUco board, an
        AprilGrid, a circle grid or a square grid of any size. Two of them must agree. A chessboard, circles and
        squares are proposed where detection finds them under that very SPEC; a marker board where the ids of
        its markers fit the places at which they lie for one number of columns only, and its number of rows
        where an image shows its end. The marker's side, which is measured to some percent, is left to you.
        Markers in mirrored images cannot be read: the board is looked for in the mirrored image too.""",
    "markers-too-small": """
        The squares of a ChArUco board are found when they are 7 px wide. Its markers are read by their code: rendered
        sharp, all are read where a cell of the code is 2.5 px wide, half of them at 1.8 px, none at 1 px. Without markers it is
        not known which corner is which, and images that show a part of the board only are of no use.""",
    "board-in-one-camera-only": """
        One camera's images show the board, the other's none. Look at the one that the message names: the board may be outside
        that camera's view, out of focus or too dark, or the wrong folder was given.""",
    "board-in-too-few-pairs": """
        A pair counts if both images show the board; three are needed. The message says in how many images of each camera it
        was found, and the commonest reason why it was not in the others.""",
    "points-off-target": """
        A target that is no plane is laid into every image by least squares. What its points then miss their corners by is a
        tenth of its size in the image, in most views: no lens does that. The points may be in another order than the corners, z
        may point the other way, or one axis be in another unit.""",
    "solid-target-seen-flat": """
        Six points that do not lie in one plane determine a camera from one image. Of a cube of which every image shows one face
        alone, nothing but planes is seen, and which face is which plane's is all that the target adds.""",
    "points-beyond-their-sigma": """
        Points whose places are stated with a standard deviation are moved within it. How far they moved is compared with it;
        at one and a half times the stated, RMS over all points, the statement does not hold, and the stated sigmas of the rig,
        which rest on it, do not either.""",
    "points-not-as-given": """
        What a target's points are off by repeats from view to view, unlike noise. They are freed by a twentieth of the target's
        size, with all else: where the corners' noise then falls below seven tenths of what it was, the points are elsewhere than
        given, and the rig and its sigmas rest on wrong ones. A face that is 5 % too long among three leaves 1.6 px in place of 0.14
        and moves the focal length by ten sigmas.""",
    "view-off-target": """
        The points of a target that is no plane, laid into this image by least squares, miss its corners by a tenth of its
        size or more, or the image shows too few of them for a pose.""",
    "several-boards": """
        In half of the images or more, more than one chessboard is seen and nothing says which is meant. `binocal calibrate` and
        `binocal evaluate` then take every board of the SPEC for a view of its own; this refusal is what `binocal.detect_pairs`
        and the other verbs say, which are about one board. With fewer such images, those alone are left out: another board may
        stand about.""",
    "boards-not-paired": """
        Each camera's boards give its lens and every board's pose. A pair of boards then proposes where the right camera stands,
        and is believed if that puts three boards or more of the left images where the right ones show boards of their SPEC, and
        no other proposal matches more than six tenths as many. Boards that hang in an even row, tilted alike, match shifted by
        one as well, and a rig from such pairs would be wrong without any sign of it.""",
    "parameters-undetermined": """
        The normal equations are singular: some combination of parameters changes nothing that the corners show. The sentence
        names the parameters that take the largest part in it.""",
    "too-few-measurements": """
        There are fewer corner coordinates than unknowns: six for each view's board pose, and the cameras' own.""",
    "too-few-views": """
        Two views determine four intrinsics and leave nothing to check them with. The message says which camera sees the board
        in how many views, or why most of the others were left out; the list of views that came with it says so of each.""",
    "corners-outside-image": """
        Corners that fit the board well lie beyond the image's edge. The stated image size is not that of the images in which
        the corners were found; often width and height are exchanged.""",
    "columns-and-rows-exchanged": """
        Read column by column the corners fit the board, row by row they do not. The board was described with its columns and
        rows exchanged, or another detector numbers corners column by column.""",
    "corners-off-grid": """
        In most views no homography maps the board's points onto the corners. The numbers of columns or rows are wrong (inner
        corners are counted for chessboards, squares for ChArUco boards), or the order of the corners is another one.""",
    "too-few-poses": """
        Repeated poses count once: a tripod and ten images of a board that nobody moved are one view.""",
    "boards-parallel": """
        All boards have the same direction, as far as the noise of the corners tells. Moving the board without tilting it
        says nothing about the focal length.""",
    "no-perspective": """
        The boards' images are shortened as those of boards that are tilted in different directions, but parallel lines of the
        board stay parallel: the board is small beside its distance. The focal length follows from perspective alone, so that
        more tilt would not help.""",
    "tilts-too-small": """
        The closed form, before any solve, knows the focal length to worse than half of itself. A start like that may end
        anywhere.""",
    "image-size-wrong": """
        All corners lie in the first part of the image, and the principal point is the middle of that part, not of the image:
        the corners were found in smaller images than the size that was stated.""",
    "resolution-mismatch": """
        Boards look smaller in one camera by the same factor by which its corners keep to the first part of the image: the
        corners were found in images of half (or another share of) the resolution.""",
    "pairs-shifted": """
        When the right sequence is moved by one or a few images against the left one, the pairs agree. An image is missing at
        the beginning of one sequence, or two recordings were started apart.""",
    "one-side-mirrored": """
        A flipped image of a symmetric board looks like another sound image of it, so each camera calibrates by itself; only the two
        together tell. When the corners of one side are flipped back, the pairs agree on a rig. Which side it is cannot be known
        from a symmetric board. Images that are transposed (columns and rows exchanged) are mirrored as well.""",
    "images-mixed-up": """
        A calibrated rig says what its images can be. Where most views are missed by more than a pixel, the corners are looked at again
        as if left and right were exchanged, images mirrored or upside down, or the lists off by up to three images. One of these makes
        the views fit at least five times better. Nothing is repaired: the images are to be given as the cameras took them.""",
    "view-mirrored": """
        The rig that the other pairs agree on explains this one when one of its images is flipped back.""",
    "left-and-right-contradict": """
        Each camera alone makes sense, but no single rotation and translation between them explains the pairs. The
        images were not taken at the same moment while something moved, the cameras moved against each other, or the two
        cameras number the board's corners differently.""",
    "focal-length-uncertain": """
        The focal length is known worse than one percent, and distances with it. The rig is usable where that is enough.""",
    "image-size-doubtful": """
        Lens mounts scatter both ways. Two principal points that lie short of the middle by the same share, by more than their
        standard deviations explain, with no corner beyond the size that would put them into the middle, mean that the stated
        size is too large.""",
    "lens-model-folds": """
        Beyond some radius the fitted distortion bends image points back inwards, so that a pixel out there belongs to no
        direction: it cannot be rectified, and no depth comes from it. The corners say nothing about that part of the image. It
        happens where the board never reached the image's corners, and where a model has more coefficients than the views
        determine. `--model auto` takes another model where one is as good.""",
    "image-size-suspect": """
        As for both cameras, with one of them: its principal point lies far from the middle, and its corners end where an
        image of a smaller size would.""",
    "cameras-exchanged": """
        Seen from either camera, the one called right stands to the left. Nothing is wrong with the numbers; most stereo
        software expects the other order. Of a rig with one camera upside down or on its side this is not said: there the two
        cameras see their order differently, and exchanging them would change nothing. Mirrored images of both cameras, as
        some webcams give them, look the same: a chessboard is its own mirror image.""",
    "corner-orders-repaired": """
        A chessboard with an even and an odd number of squares has no upside-down, others have. The two cameras numbered the
        corners from different ends in most views; they were put into one order. A camera that is mounted upside down does so,
        and nothing is wrong then.""",
    "start-simplified": """
        The views could not carry all parameters of the closed form; the joint solve started from fewer. It finds the others
        by itself; look at their standard deviations.""",
    "corners-without-weight": """
        A few wild corners per thousand are usual. More come from reflections, a covered board, motion blur, or a lens model
        that does not follow the lens into the corners of the image.""",
    "pairs-not-together": """
        Each camera is also fitted alone, with the same board. Where both together fit many times worse than each alone, the two
        did not see the board in one place: they were not triggered together while the board or the rig moved. Every view's
        right pose is then freed within a variance that the data give; but at 15 times the noise, or where what is left determines no
        rig, nothing that comes out of it should be used.""",
    "exposures-apart": """
        As for pairs that were not taken together, but less: the relative pose of each view scatters clearly more than the
        images themselves do. The rig is estimated with a deviation of the right pose in each view, whose size comes from the
        data, and the standard deviations are as large as that makes them. Pairs taken at rest give a better rig from fewer
        views. A board that always moves alike, as on a conveyor, cannot be found out by this.""",
    "corner-lists-shifted": """
        A detector that takes the board's rim for a row, or loses the first one, numbers all corners off by one. In both
        cameras alike that does no harm. In one of them, and in all views, it looks like a rig that stands one square
        elsewhere. The suspicion is checked by shifting the lists back and solving again.""",
    "rig-changed": """
        A camera that was knocked, refocused, or whose image is shifted (a stabiliser, a loose sensor) leaves two rigs in one
        recording. The change is looked for at every view; it is named where it alone removes four fifths of what the pair
        leaves beyond the cameras alone. Which of the two cameras moved is named rightly in seven cases of ten; the size is right
        to a few percent.""",
    "rig-drifts": """
        As for a rig that changed, but evenly over the recording: heat, a sagging mount, a slipping focus.""",
    "rig-has-two-states": """
        As for a rig that changed, but to and fro: the views fall into two groups, each of which fits by itself.""",
    "changed-from-view": """
        When the rig changes a lot, the views after it (or before it, whichever are fewer) contradict the others and are left
        out, as single bad views are. That all of them lie at one end of the recording says what happened. If the rig changed
        towards the end, the result is of the rig as it was before.""",
    "many-views-left-out": """
        A few bad views are to be expected, and one or two are left out without further ado. Where more than a fifth contradict
        the others, scattered over the recording, the majority is not to be believed unseen: the rig may have had two states,
        or the cameras were not always triggered together.""",
    "rests-on-few-views": """
        Rotation and translation between the cameras come from views that both of them see. Where such views are few, or two
        or three outweigh all others, or most of the given views were left out, nothing is left to notice an error in them.""",
    "too-few-views-beside-copies": """
        No rig follows from the views, and half of them or more are exact copies of others, or all but one or two are: a pair
        that was saved several times, or a list that repeats a name. Copies show nothing new, so tilting the board in them
        cannot be asked for: other pairs are needed.""",
    "views-copied": """
        Exact copies of an image add no information, but would make all standard deviations smaller. They are counted once.""",
    "few-different-poses": """
        Views that show the board in the same place to within the noise say little more than one of them.""",
    "board-scale-uncertain": """
        Over all its points the board's scale is taken for that of the drawing; images cannot tell it. How far that may be wrong
        is estimated from the print's other errors: a print that is 1 % wider than high was probably not to size either way.
        The standard deviations of baseline and translation do not hold this, `board_shape.scale_sigma` does. The warning comes
        at 0.25 %; good prints stay below 0.2 %.""",
    "scale-doubtful": """
        Boards are made with squares of a millimetre to half a metre. Images look the same whatever the size; only the
        plausibility of the number can be checked.""",
    "aprilgrid-gap-wrong": """
        Kalibr's files and many printed boards differ in what they call the spacing of the tags. The board's points are estimated
        along with the rig; where their pattern is that of another gap, the sentence gives the gap that fits.""",
    "matches-too-few": """
        Calibration from natural images rests on points that both cameras saw. Where an image is black, blurred, overexposed or
        shows a bare wall, or where the images of a pair do not show one scene, few are found, and no pose follows from them.""",
    "matches-on-whole-rows": """
        In rectified images points of one thing lie on one row. A detector that measures to whole pixels then gives matches whose
        rows are equal to the last digit, whatever the rig's error: they would say that the rig is perfect. Windows fitted to a
        fraction of a pixel, as binocal does, show rows as they are.""",
    "matches-contradict": """
        Nearly all matches of a pair must agree with one pose between the cameras. Where they do not, the images are not of one
        moment while something moved, left and right are exchanged, the images were rectified or scaled, or the rig file is of
        other cameras.""",
    "scene-tells-too-little": """
        Points that are all far away tell the rotation and not the direction of the translation; points in a small part of the
        image tell yaw apart from the forward part of the translation only badly. Where a standard deviation exceeds a degree of
        turn or twelve degrees of direction, nothing is said instead of something wrong.""",
    "scene-tells-too-little-kept": """
        As *the scene does not tell the pose*, but an old rig was given: the directions that the scene does tell are estimated,
        the others stay as the old rig has them, with standard deviations that say so. Where an angle or the direction of the
        translation is untold by itself, it stays exactly as it was. Where the scene does not tell unknowns apart, such as yaw
        from the forward part of the translation, it is their combination that stays, and the text states it: the sum of the
        changes from the old rig, in degrees and with these factors, is 0, while each of them alone may have changed.""",
    "image-shows-nothing": """
        Points are sought where the image changes in two directions. An image in which hardly any stand out is black, white,
        covered, of a bare wall, or far out of focus.""",
    "image-blurred": """
        Around the points that both images show the spread of edges is measured, noise taken out: 0.9 to 1.2 px in sharp images,
        within 2 % the same in both images of a pair, whatever the gain and noise of either camera. A blur of 1.5 px in one of
        them makes it a third larger, and matches of a sharp with a blurred
        image are off by up to half a pixel, all in like directions: rotations come out wrong by tenths of a degree and more
        than is stated. Pairs are refused (of several: left out) from a ratio of 1.25, or 2.5 px in both.""",
    "image-mirrored": """
        Descriptors of a mirrored image match nothing but what is symmetrical, and a pose fits a cluster of those as well. Where
        few points match, one image is mirrored and tried again: three times as many matches, and a hundred, say that it was.
        The pair is refused (of several: left out). Where both images are mirrored, their sides seem exchanged.""",
    "images-already-rectified": """
        In rectified images matching points lie on equal rows. Where they do so to less than the noise that the best pose of the
        given rig leaves, the images were rectified by somebody, while the rig's file has the lenses of the raw images.""",
    "rig-is-another": """
        Heat and knocks turn a rig by a fraction of a degree, at most a few degrees, and its translation with it. Where the
        images ask for more than 15 deg, or for a translation that turned by 6 deg more than the rig did, the cause is named
        that the figures point to: upside down images, exchanged sides, other cameras (the parameter is named that would save
        most of the residuals), or images that are not of one moment.""",
    "pose-unlike-file": """
        With `--start none` the pose is found without the rig file's. It is compared all the same: exchanged sides, upside down
        images and a translation that lies 15 deg more along the view than the file's are refused, since no other mounting of
        the cameras explains them. A pose that is as far from the file's as would be refused without `--start none` may be
        right, and is said to be far.""",
    "baseline-unlike-file": """
        The images tell the direction of the translation, not its length, so that a unit mixed up or a mistaken known length shows
        in no residual. `--baseline` and `--known-length` are taken as they are given. Where they differ from the rig's file by more
        than 5 %, and by more than four standard deviations of their difference, this is said: heat and knocks change the distance of
        two cameras by far less.""",
    "cameras-are-others": """
        Focal lengths, principal points and distortions of both cameras are held; freed together, beside a pose for each pair, they
        would take away what a wrong calibration leaves. What a good calibration may leave, three standard deviations of each
        pattern, is set off. Where the rest is more than 35 % of the squared residuals and more than 0.045 px (RMS), the cameras
        are not those of the images, and a turn of the rig would be an artefact. Good calibrations leave up to 31 % where it is
        0.03 px, and up to 19 % where it is 0.056 px. Of rectified images without a lens a focal length that both cameras have
        wrong leaves nothing: rows stay equal, and this cannot tell.""",
    "pairs-contradict": """
        Every pair of a rig shows the same pose. Where half of the pairs or more do not fit with the others, nothing tells which
        are right. Where each pair fits the cameras with a pose of its own, and no pose fits all (own poses would take away 80 % of
        the squared residuals, and 0.3 px), or where two and more pairs that do not fit with the others agree on another turn,
        the rig was knocked on the way, it flexes, its cameras do not expose together, or its file is of other cameras.
        `recalibrate` and `check` refuse such pairs alike: any one pose would be a mean of several. `binocal check --stream`
        says when the rig turned, and by how much.""",
    "pairs-left-out": """
        A pair is left out where an image shows nothing or is blurred, where less than half as many of its matches fit as of all
        pairs (its images are not of one moment, or the rig was knocked before or after it), or where its points lie behind the cameras
        (its images were exchanged). The result is that of the other pairs. Several that agree on another turn are
        [refused](pairs-contradict.md).""",
    "pairs-disagree": """
        Of several pairs one pose is asked for. To each is then given the pose that fits it alone, and what that takes off the
        squared residuals is compared with what errors of matches explain, alike as they are within a region of an image. A
        quarter of the squares and five times as much is said. KITTI's gray cameras on a moving car have 43 to 61 % and 10 to
        18 times, 0.07 to 0.11 px; EuRoC's and BumbleBee2's up to 11 % and 3.5 times. The pose is a mean then, and its standard
        deviations count how the pairs differ.""",
    "matches-ask-for-other-cameras": """
        The cameras' parameters are held. For each focal length, principal point and k1, freed alone beside the pose, it is
        asked how much of the squared residuals it would save and whether all regions of the images agree on it. More than a
        third and four standard deviations are a sign that the calibration of that camera is not right any more. The value that
        the matches ask for is a diagnosis, no result: freed parameters go wrong by more than they were uncertain, while the
        residuals fall.""",
    "lines-too-few": """
        Vanishing points come from straight edges of some length, a fiftieth of the image's diagonal and more. Twenty in one image
        are needed to look for directions that they have in common.""",
    "lines-without-families": """
        Lines that are parallel in the scene meet in one point of the image. Segments that lie anywhere also meet here and there;
        a family is taken only where chance would give its evidence less often than exp(-10) over all crossings of two segments.
        Plants, stones and texture have no families.""",
    "lines-in-one-family": """
        One vanishing point is one direction, which every camera can see. Two directions at right angles are needed for a focal
        length.""",
    "lines-not-at-right-angles": """
        Two or more families of parallel lines were found, but there is no focal length at which two of them stand at right angles
        while the principal point is near the image's middle, or only one for less than half of the images. Furniture, roofs and
        streets that meet at other angles do that, and so do cropped images and strong lenses that were not taken out.""",
    "right-angles-unchecked": """
        Any two vanishing points on different sides of the principal point are at right angles for some focal length. That they
        really are is checked by a third family found by itself, or by views turned by ten degrees and more, for which a wrong
        angle would give other focal lengths. Of ten unchecked pairs in real images four were not at right angles and
        gave focal lengths 25 to 50 % off. If you know that the two are (a facade, a table), say `--right-angles`.""",
    "vanishing-points-far": """
        Lines that are nearly parallel in the image as well, a wall seen face on or a street seen along, leave the focal length
        open: their vanishing points are at infinity whatever it is. A focal length counts as measured below a standard deviation of
        10 %, a coordinate of the principal point below a third of what is assumed of it.""",
    "vanishing-points-far-focal-untold": """
        The one vanishing point that is near, of a street seen along, lies at the principal point within the camera's turn against
        the others, which are at infinity. So the lines tell the principal point where they leave the focal length open.""",
    "lens-from-bent-lines": """
        Without a rig nothing is known of the lens. Where lines bend as a lens bends them, all over the image and by at least
        seven standard deviations, one radial coefficient is taken from the bend. It leaves what higher coefficients do, which is
        some tenths of a pixel to some pixels in the corners; a calibrated lens leaves less.""",
    "stream-too-few": """
        A stream is watched by comparing its pairs with each other; one or two cannot be. Each skipped pair is listed with what
        it shows.""",
    "stream-jumped": """
        The odds that the rig has turned at once, against all measured turns being of a rig that stands or creeps, exceed a
        threshold. It was set by simulation so that 5 % of the streams of 1700 pairs of a rig that does not move raise an alarm
        in one of the three angles (`binocal bench drift`). The pair named is the first after the jump by the most probable account; it can be
        off by a few where the jump is small.""",
    "stream-pairs-skipped": """
        Pairs that are black, blurred or show a bare wall, or whose scene leaves an angle open, tell no turn. They are left out
        and time goes on.""",
    "stream-without-times": """
        A rate of drift needs times. They are taken from the data set, from files that are named by their time since 1970 (in
        nano-, micro- or milliseconds), or from `--fps`. Jumps are found without them.""",
    "principal-points-near-middle": """
        Through a telephoto lens a shift of the principal point moves the image almost as a turn of the camera does, with a
        little of the distortion in between. The views then leave the principal points open by a tenth of the image and more,
        in a way that standard deviations do not describe. Lenses sit near the middle of their sensors, so that this is counted
        as knowledge. It moves rectified rows and depth by no more than they are uncertain anyway. Images that were cropped out
        of larger ones have their principal points elsewhere: calibrate the whole images then.""",
    "images-differ-in-noise": """
        Blur, motion, light and distance make the corners of one image many times noisier than those of another. The noise of
        each image is estimated from what a smooth map leaves of its residuals after the first steps of the solve; from then on
        its corners count accordingly. Corners that come with covariances need no such estimate. Nothing is wrong with the
        result; as sharp images of all views would make it better.""",
    "board-not-as-drawn": """
        No print is flat and to size. A bow or a stretch that the board was not drawn with moves corners alike in all views, so
        it can be separated from the cameras, and binocal estimates every point of the board along with the rig. The note comes
        where bow or stretch exceed three of their standard deviations and move corners by more than half of the noise. Only
        the scale of the print remains unknown: over all of its points it is taken for that of the drawing.""",
    "corners-lock-to-pixels": """
        In images that were made smaller without smoothing, enlarged, or read from every other pixel, an edge is
        measured at a place that depends on where it lies between the pixels. The error repeats with the pixels, or with those of the image
        before it was enlarged (2, 3 or 4 of today's). It is alike in all views, so that the residuals show it; a few
        harmonics of each camera's axes were fitted to them and taken from the corners before the solve went on. The curve
        stands in the provenance (`pixel_locking`). What it cannot mend is the sharpness that the images have lost.""",
    "model-choice-weak": """
        Camera models are compared by the rows and lengths of views that were held out. With fewer than six views nothing can
        be held out, and the Bayesian information criterion decides.""",
    "view-without-corners": "Neither camera saw the board in this view.",
    "view-off-grid": """
        The corners of this view are no perspective image of the board: a wrong detection, or an order of its own.""",
    "view-at-one-point": """
        Some programs write (0, 0) for corners that were not found. Corners that were not seen are NaN.""",
    "view-on-a-line": "A single row of corners determines no pose of the board.",
    "view-shifted": """
        The corners of one camera are numbered one or two rows or columns off, as happens when a detector takes the board's
        rim for a row.""",
    "view-mismatched": """
        The rig that the other pairs agree on does not explain this one: the images do not belong together, or the board or
        the rig moved between them.""",
    "view-contradicts": """
        Most corners of one camera were given no weight by the joint solve. The view was left out and the others solved anew.""",
    "view-reordered": """
        The corner order of one camera was a symmetry of the board against the other camera's. It was put right; corner
        numbers in the result are those of the repaired order.""",
    "dataset-kind-unknown": """
        A data set is named by its kind, a colon and its folder; some take a choice after another colon. [Data
        sets](../how-to/datasets.md) lists them.""",
    "dataset-layout-unknown": """
        The folders or names that the kind of data set has are not there: the path is a level too high or too low, it is another
        kind of data, or the archives were rearranged. [Data sets](../how-to/datasets.md) draws each layout.""",
    "dataset-part-not-chosen": """
        Drives and sequences of different days have different calibrations, so none is taken by chance.""",
    "dataset-side-missing": """
        Most data sets are published as one archive per camera; a pair needs both.""",
    "dataset-calibration-missing": """
        The calibration is often an archive of its own. Without it a data set has no cameras; as `folder:PATH` its images can be read
        alone.""",
    "dataset-calibration-broken": """
        The sentence names the file and, where it can, the line. What is checked: that every entry that is needed is there once and has
        as many numbers as it should, that rotations are rotations to the digits printed, that a camera's focal length and principal
        point belong to its image, that the baseline is one that a stereo camera has (5 mm to 5 m), and that redundant entries agree.""",
    "dataset-frames-unmatched": """
        KITTI and Cityscapes are published with every image of both cameras, so an image without its partner means that an
        archive is missing or was unpacked in part. Images matched by time are left out instead, unless none match.""",
    "dataset-image-size-differs": """
        A calibration holds for the size of image that it was made with. Images that were resized need another focal length, cropped
        ones another principal point; rectified images with the calibration of raw ones give a wrong rig without any other sign.
        KITTI's `P0` to `P3` and Cityscapes' files do not say a size: there both images of a pair must have the same, and the
        principal point must lie near their middle, which tells about what size was calibrated.""",
    "dataset-frame-unknown": """
        `--rig-of` names the pair whose calibration is to be used, by its whole name or by how that begins (a city of Cityscapes, a
        number of KITTI's). The names are those of the left images without their ending; the message lists the first.""",
    "known-length-not-found": """
        The ends of a `--known-length` are given in the left image; their partners are sought in the right one along the epipolar
        line, by a window of 19 pixels, or of 13 or 9 where that shows things at several depths. An end in the middle of a blank wall,
        at the image's border, on a repeated pattern, or hidden from the right camera has no clear partner.""",
    "known-length-tells-too-little": """
        The length of the translation is the old one times the true length over the measured one, so it is as uncertain as the
        measured length: a pixel of pointing and of matching at both ends, and what the rig's turn is uncertain by, which matters where
        the ends lie at different depths. Twenty percent and more are not written into a rig.""",
    "known-lengths-disagree": """
        Each `--known-length` gives a baseline of its own, with a standard deviation. Two of them differ by more than four of those of
        their difference: a length is mistaken, or an end does not lie where it was pointed at. The result is their weighted mean.""",
    "dataset-rigs-left-out": """
        Cityscapes, KITTI's stereo and object sets and Middlebury have a calibration for every image, and pairs of different rigs must
        not be pooled. Used is the calibration that `--rig-of FRAME` names, else the one whose cameras are those of `--rig`, else the
        one of most pairs; all pairs of other calibrations are left out.""",
    "dataset-has-several-rigs": """
        Cityscapes, KITTI's stereo and object sets and Middlebury have a calibration per image, which changes between recordings.
        Pairs of different rigs must not be pooled. `Dataset.by_rig()` gives the parts that have one rig each, the largest first.""",
    "dataset-frames-left-out": """
        Cameras drop images now and then. A pair is made where two times are each other's nearest and no more than half a period
        apart; in plain folders, where names agree. The rest is listed in `Dataset.ignored`.""",
}


def sentence_with_places(kind: FindingKind) -> str:
    """The sentence with the figures' names in angle brackets and the remedy written out."""
    parts = []
    for text, name, spec, _ in string.Formatter().parse(kind.sentence):
        parts.append(text)
        if name and spec and "|" in spec:  # one word or the other, by a number
            parts.append(spec.partition("|")[2])
        elif name == "remedy":
            parts.append(kind.remedy.replace("{", "⟨").replace("}", "⟩").replace(":.0f", ""))
        elif name:
            parts.append(f"⟨{name}⟩")
    return "".join(parts)


def paragraph(text: str, prefix: str = "") -> str:
    """The text in lines of one width."""
    options = {"break_long_words": False, "break_on_hyphens": False}
    return textwrap.fill(" ".join(text.split()), WIDTH, initial_indent=prefix, subsequent_indent=prefix, **options)


def page(kind: FindingKind) -> str:
    """The page of one code."""
    lines = [f"# {kind.title}", "", f"`{kind.code}`, {kind.severity}.", "", paragraph(EXPLANATIONS[kind.code]), ""]
    lines += ["The sentence, with the names of its figures:", "", paragraph(sentence_with_places(kind), "> "), ""]
    limits = [limit for rule in RULES if rule.code == kind.code for limit in rule.limits]
    if limits:
        lines += ["| compared | limit | why there |", "|---|---|---|"]
        lines += [
            f"| {limit.what} | {limit.value:g} {limit.unit} | {limit.reason} |".replace("  |", " |") for limit in limits
        ]
        lines += [""]
    if kind.error is not None:
        lines += [
            f"Raised as `binocal.{kind.error.__name__}`; the command line ends with exit code {exit_code(kind)}.",
            "",
        ]
    lines += ["[All findings](index.md)"]
    return "\n".join(lines) + "\n"


def exit_code(kind: FindingKind) -> int:
    """What the command line ends with."""
    return 1 if kind.error is not None and kind.error.__name__ == "NotConvergedError" else 3


def index() -> str:
    """The index of all codes."""
    intro = """
        What binocal has to say about a calibration has a code that never changes its meaning. In Python it is
        `calibration.findings`, or `error.findings` of an exception; in `rig.json` and with `--json` it is the list `findings`,
        each with `code`, `severity`, `figures`, `text` and `remedy`. Sentences may be reworded; programs depend on codes."""
    lines = ["# Findings", "", paragraph(intro), ""]
    for severity, heading in HEADINGS.items():
        lines += [f"## {heading}", "", "| code | meaning |", "|---|---|"]
        lines += [f"| [`{k.code}`]({k.code}.md) | {k.title} |" for k in KINDS.values() if k.severity is severity]
        lines += [""]
    return "\n".join(lines).rstrip() + "\n"


def rules_table() -> str:
    """The limits of every rule, for docs/method.md."""
    lines = ["| finding | compared | limit | why there |", "|---|---|---|---|"]
    for rule in RULES:
        for limit in rule.limits:
            value = f"{limit.value:g} {limit.unit}".strip()
            lines.append(f"| [{rule.code}](findings/{rule.code}.md) | {limit.what} | {value} | {limit.reason} |")
    return "\n".join(lines) + "\n"


def with_rules_table(text: str) -> str:
    """The text of docs/method.md with the table between its marks renewed."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{rules_table()}\n{END}{after}"


def pages() -> dict[str, str]:
    """Every file of the folder and its text."""
    return {"index.md": index()} | {f"{kind.code}.md": page(kind) for kind in KINDS.values()}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.md"):
        old.unlink()
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    METHOD.write_text(with_rules_table(METHOD.read_text(encoding="utf-8")), encoding="utf-8")
