// The extension module: every source file of this folder registers its own functions here.
#include "kernel.hpp"

NB_MODULE(_kernel, module) {
    module.doc() = "The compiled kernels of binocal. Use them through binocal.kernels.";
    binocal::register_accumulate(module);
    binocal::register_planes(module);
    binocal::register_point_lattice(module);
    binocal::register_poses(module);
    binocal::register_step(module);
    binocal::register_corner_fit(module);
    binocal::register_ellipse_fit(module);
    binocal::register_image_lens(module);
    binocal::register_joint_views(module);
    binocal::register_library_words(module);
    binocal::register_marker_cells(module);
    binocal::register_marker_growth(module);
    binocal::register_motion(module);
    binocal::register_observe(module);
    binocal::register_template_match(module);
    binocal::register_rectified_map(module);
    binocal::register_saddles(module);
    binocal::register_spots(module);
    binocal::register_square_fit(module);
    binocal::register_xcorners(module);
}
