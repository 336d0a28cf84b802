// The inner loops of ellipse_fit.hpp, eight pixels at a time. Included once per instruction set, behind corner_fit_loops.hpp, hence unguarded.

// Fills the Jacobian's columns and the residual's.
inline void linearize(EllipseWorkspace& work, const double* p) {
    const EllipsePatch& patch = work.patch;
    const Lane cx = constant(p[kCentreX] - patch.column), cy = constant(p[kCentreY] - patch.row);
    const Lane mxx = constant(p[kShapeXX] * patch.unit), mxy = constant(p[kShapeXY] * patch.unit), myy = constant(p[kShapeYY] * patch.unit);
    const Lane over_blur = constant(std::exp(-p[kBlur])), unit = constant(patch.unit);
    const Lane a = constant(p[kLevel]), b = constant(p[kHalf]), gx = constant(p[kLightX]), gy = constant(p[kLightY]);
    const Lane one = splat(1.0f), zero = splat(0.0f), far = splat(8.0f), half = splat(0.5f), density = splat(0.79788456f);
    const Lane least = splat(kLeastRelativeRadius * kLeastRelativeRadius), tiny = splat(1e-12f);
    for (int i = 0; i < patch.n_vectors; ++i) {
        const int at = i * kLanes;
        const Lane u = load(work.u() + at) - cx, v = load(work.v() + at) - cy;
        const Lane wx = mxx * u + mxy * v, wy = mxy * u + myy * v;
        const Lane q = max_of(u * wx + v * wy, least);
        const Lane r = square_root(q), over_n = one / square_root(max_of(wx * wx + wy * wy, tiny));
        const Lane distance = (q - r) * over_n;  // signed, px, negative inside
        const Lane steep = (one - half / r) * over_n;  // of the distance to q
        const Lane lost = distance * over_n * over_n;  // of the distance to the length of w, over that length
        const Lane d = min_of(max_of(distance * over_blur, zero - far), far);
        const Lane gauss = exponential(zero - half * d * d);
        const Lane F = error_function(d, gauss);
        const Lane light = one + gx * u + gy * v;
        const Lane print = a + b * F;
        const Lane edge = light * b * density * gauss * over_blur;  // of the grey value to the distance
        const Lane to_u = edge * ((steep + steep) * wx - lost * (mxx * wx + mxy * wy));
        const Lane to_v = edge * ((steep + steep) * wy - lost * (mxy * wx + myy * wy));
        const Lane edge_unit = edge * unit;
        store(work.column(kCentreX) + at, zero - to_u - print * gx);
        store(work.column(kCentreY) + at, zero - to_v - print * gy);
        store(work.column(kShapeXX) + at, edge_unit * (steep * u * u - lost * wx * u));
        store(work.column(kShapeXY) + at, edge_unit * ((steep + steep) * u * v - lost * (wx * v + wy * u)));
        store(work.column(kShapeYY) + at, edge_unit * (steep * v * v - lost * wy * v));
        store(work.column(kBlur) + at, zero - edge * distance);
        store(work.column(kLevel) + at, light);
        store(work.column(kHalf) + at, light * F);
        store(work.column(kLightX) + at, print * u);
        store(work.column(kLightY) + at, print * v);
        store(work.column(kEllipseParameters) + at, load(work.value() + at) - print * light);
    }
    // The vector's last pixels are none.
    for (int k = 0; k <= kEllipseParameters; ++k)
        for (int i = patch.n_pixels; i < patch.n_vectors * kLanes; ++i) work.column(k)[i] = 0;
}

inline void multiply(EllipseWorkspace& work, EllipseEquations& out) {
    constexpr int rows = 3, columns = 4;  // of a block: twelve sums and seven operands stay in registers
    static_assert(kEllipseColumns % rows == 0 && kEllipseColumns % columns == 0);
    for (int i = 0; i < kEllipseColumns; i += rows) {
        for (int j = i / columns * columns; j < kEllipseColumns; j += columns) {
            Lane sum[rows][columns];
            for (auto& row : sum)
                for (auto& value : row) value = splat(0.0f);
            for (int k = 0; k < work.patch.n_vectors; ++k) {
                Lane right[columns];
                for (int t = 0; t < columns; ++t) right[t] = load(work.column(j + t) + k * kLanes);
                for (int s = 0; s < rows; ++s) {
                    const Lane left = load(work.column(i + s) + k * kLanes);
                    for (int t = 0; t < columns; ++t) sum[s][t] = sum[s][t] + left * right[t];
                }
            }
            for (int s = 0; s < rows; ++s)
                for (int t = 0; t < columns; ++t) out.gram[i + s][j + t] = out.gram[j + t][i + s] = sum_of(sum[s][t]);
        }
    }
}
