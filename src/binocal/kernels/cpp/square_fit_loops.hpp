// The inner loops of square_fit.hpp, eight pixels at a time. Included once per instruction set, behind corner_fit_loops.hpp, hence unguarded.

// Fills the Jacobian's columns and the residual's.
inline void linearize(SquareWorkspace& work, const double* p, const SquareEdges& edges) {
    const SquarePatch& patch = work.patch;
    const Lane one = splat(1.0f), zero = splat(0.0f), half = splat(0.5f), far = splat(8.0f), tiny = splat(1e-30f);
    const Lane a = constant(p[kSquareLevel]), b = constant(p[kSquareHalf]), gx = constant(p[kSquareLightX]), gy = constant(p[kSquareLightY]);
    const Lane density = splat(0.39894228f);
    struct {
        Lane x, y, tx, ty, over_length, over_blur, bow[3];
    } edge[4];
    struct {
        Lane rho, over_rest, half_over, joint, sine[6], half_secant[6], share[6], to_first, to_second;
        const Quadrature* rule;
    } corner[4];
    for (int i = 0; i < 4; ++i) {
        const SquareEdge& e = edges.edge[i];
        edge[i] = {constant(p[2 * i] - patch.column), constant(p[2 * i + 1] - patch.row), constant(e.tx), constant(e.ty), constant(1 / e.length),
                   constant(std::exp(-p[kSquareBlur1 + i % 2])), {constant(e.bow[0]), constant(e.bow[1]), constant(e.bow[2])}};
        const SquareEdge& before = edges.edge[(i + 3) % 4];  // it ends in corner i, at which edge i begins
        double rho, first, second;
        before.meet(e, rho, first, second);
        const double rest = std::sqrt(1 - rho * rho), arc = std::asin(rho);
        const Quadrature& rule = quadrature_for(rho);
        auto& c = corner[i];
        c.rule = &rule;
        c.rho = constant(rho), c.over_rest = constant(1 / rest), c.half_over = constant(-0.5 / (rest * rest));
        c.joint = constant(1 / (2 * 3.14159265358979 * rest)), c.to_first = constant(first), c.to_second = constant(second);
        for (int k = 0; k < rule.n; ++k) {
            const double t = arc * rule.node[k], cosine = std::cos(t);
            c.sine[k] = constant(2 * std::sin(t)), c.half_secant[k] = constant(-0.5 / (cosine * cosine));
            c.share[k] = constant(arc * rule.weight[k] / (2 * 3.14159265358979));
        }
    }
    for (int i = 0; i < patch.n_vectors; ++i) {
        const int at = i * kLanes;
        const Lane x = load(work.u() + at), y = load(work.v() + at);
        Lane z[4], gauss[4], E[4], along[4], steep[4];
        for (int k = 0; k < 4; ++k) {
            const Lane u = x - edge[k].x, v = y - edge[k].y;
            along[k] = (edge[k].tx * u + edge[k].ty * v) * edge[k].over_length;
            const Lane t = min_of(max_of(along[k], splat(-0.5f)), splat(1.5f)), rest = one - t;
            const Lane bow = edge[k].bow[0] + t * (edge[k].bow[1] + t * edge[k].bow[2]);
            const Lane bow_slope = edge[k].bow[1] + splat(2.0f) * t * edge[k].bow[2];
            const Lane slope = ((rest - t) * bow + t * rest * bow_slope) * edge[k].over_length;
            steep[k] = (one - half * slope * slope) * edge[k].over_blur;
            const Lane distance = edge[k].tx * v - edge[k].ty * u - t * rest * bow;  // inward, px
            z[k] = min_of(max_of(distance * steep[k], zero - far), far);
            gauss[k] = exponential(zero - half * z[k] * z[k]);
            E[k] = error_function(z[k], gauss[k]);
        }
        const Lane A = half * (E[0] + E[2]), B = half * (E[1] + E[3]);
        Lane F = A * B, to[4], turned[4];
        for (int k = 0; k < 4; ++k) to[k] = density * gauss[k] * (k % 2 ? A : B), turned[k] = zero;
        for (int k = 0; k < 4; ++k) {
            const int before = (k + 3) % 4;
            if (!(least_of(max_of(absolute(z[before]), absolute(z[k]))) < kFar)) continue;
            const auto& c = corner[k];
            const Lane h = z[before], w = z[k], squares = h * h + w * w, product = h * w;
            for (int q = 0; q < c.rule->n; ++q) F = F + c.share[q] * exponential((squares - c.sine[q] * product) * c.half_secant[q]);
            const Lane both = exponential((squares - splat(2.0f) * c.rho * product) * c.half_over);
            // What the joint normal distribution of the two edges has beyond the product of its margins.
            const Lane H = error_function((w - c.rho * h) * c.over_rest, min_of(both / (gauss[before] + tiny), one));
            const Lane W = error_function((h - c.rho * w) * c.over_rest, min_of(both / (gauss[k] + tiny), one));
            to[before] = to[before] + density * gauss[before] * half * (H - E[k]);
            to[k] = to[k] + density * gauss[k] * half * (W - E[before]);
            const Lane of_rho = c.joint * both;
            turned[before] = turned[before] + of_rho * c.to_first;
            turned[k] = turned[k] + of_rho * c.to_second;
        }
        const Lane light = one + gx * x + gy * y, G = F + F - one, print = a + b * G, gain = splat(2.0f) * b * light;
        Lane columns_x[4] = {zero, zero, zero, zero}, columns_y[4] = {zero, zero, zero, zero}, blur[2] = {zero, zero};
        for (int k = 0; k < 4; ++k) {
            const Lane by_px = gain * to[k] * steep[k], by_turn = gain * turned[k] * edge[k].over_length;
            const Lane begins = zero - by_px * (one - along[k]) - by_turn, ends = by_turn - by_px * along[k];
            const int next = (k + 1) % 4;
            columns_x[k] = columns_x[k] - begins * edge[k].ty, columns_y[k] = columns_y[k] + begins * edge[k].tx;
            columns_x[next] = columns_x[next] - ends * edge[k].ty, columns_y[next] = columns_y[next] + ends * edge[k].tx;
            blur[k % 2] = blur[k % 2] - gain * to[k] * z[k];
        }
        for (int k = 0; k < 4; ++k) store(work.column(2 * k) + at, columns_x[k]), store(work.column(2 * k + 1) + at, columns_y[k]);
        store(work.column(kSquareBlur1) + at, blur[0]);
        store(work.column(kSquareBlur2) + at, blur[1]);
        store(work.column(kSquareLevel) + at, light);
        store(work.column(kSquareHalf) + at, light * G);
        store(work.column(kSquareLightX) + at, print * x);
        store(work.column(kSquareLightY) + at, print * y);
        store(work.column(kSquareParameters) + at, load(work.value() + at) - print * light);
    }
    // The vector's last pixels are none.
    for (int k = 0; k <= kSquareParameters; ++k)
        for (int i = patch.n_pixels; i < patch.n_vectors * kLanes; ++i) work.column(k)[i] = 0;
}

inline void multiply(SquareWorkspace& work, SquareEquations& out) {
    constexpr int rows = 2, columns = 5;  // of a block: ten sums and seven operands stay in registers
    static_assert(kSquareColumns % columns == 0 && kSquareColumns == kSquareParameters + 1);
    for (int i = 0; i < kSquareColumns; i += rows) {
        const int n_rows = std::min(rows, kSquareColumns - i);
        for (int j = i / columns * columns; j < kSquareColumns; j += columns) {
            Lane sum[rows][columns];
            for (auto& row : sum)
                for (auto& value : row) value = splat(0.0f);
            for (int k = 0; k < work.patch.n_vectors; ++k) {
                Lane right[columns];
                for (int t = 0; t < columns; ++t) right[t] = load(work.column(j + t) + k * kLanes);
                for (int s = 0; s < rows; ++s) {
                    const Lane left = load(work.column(std::min(i + s, kSquareColumns - 1)) + k * kLanes);
                    for (int t = 0; t < columns; ++t) sum[s][t] = sum[s][t] + left * right[t];
                }
            }
            for (int s = 0; s < n_rows; ++s)
                for (int t = 0; t < columns; ++t) out.gram[i + s][j + t] = out.gram[j + t][i + s] = sum_of(sum[s][t]);
        }
    }
}
