// The inner loops of corner_fit.hpp, written for eight pixels at a time. Included once per instruction set, hence unguarded.

#if defined(_MSC_VER)
struct Lane {
    float v[kLanes];
};
struct LaneInt {
    std::int32_t v[kLanes];
};
#define BINOCAL_LANE_OPERATOR(op)                                              \
    BINOCAL_INLINE Lane operator op(const Lane& a, const Lane& b) {            \
        Lane r;                                                                \
        for (int i = 0; i < kLanes; ++i) r.v[i] = a.v[i] op b.v[i];            \
        return r;                                                              \
    }
BINOCAL_LANE_OPERATOR(+)
BINOCAL_LANE_OPERATOR(-)
BINOCAL_LANE_OPERATOR(*)
BINOCAL_LANE_OPERATOR(/)
#undef BINOCAL_LANE_OPERATOR
BINOCAL_INLINE Lane splat(float s) {
    Lane r;
    for (int i = 0; i < kLanes; ++i) r.v[i] = s;
    return r;
}
BINOCAL_INLINE Lane min_of(Lane a, Lane b) {
    for (int i = 0; i < kLanes; ++i) a.v[i] = a.v[i] < b.v[i] ? a.v[i] : b.v[i];
    return a;
}
BINOCAL_INLINE Lane max_of(Lane a, Lane b) {
    for (int i = 0; i < kLanes; ++i) a.v[i] = a.v[i] > b.v[i] ? a.v[i] : b.v[i];
    return a;
}
BINOCAL_INLINE Lane with_sign_of(Lane a, Lane b) {
    for (int i = 0; i < kLanes; ++i) a.v[i] = std::copysign(a.v[i], b.v[i]);
    return a;
}
BINOCAL_INLINE Lane absolute(Lane a) {
    for (int i = 0; i < kLanes; ++i) a.v[i] = std::fabs(a.v[i]);
    return a;
}
BINOCAL_INLINE Lane exponential(Lane x) {
    for (int i = 0; i < kLanes; ++i) x.v[i] = std::exp(x.v[i]);
    return x;
}
#else
typedef float Lane __attribute__((vector_size(kLanes * sizeof(float)), aligned(32)));
typedef std::int32_t LaneInt __attribute__((vector_size(kLanes * sizeof(float)), aligned(32)));
BINOCAL_INLINE Lane splat(float s) { return Lane{s, s, s, s, s, s, s, s}; }
BINOCAL_INLINE Lane min_of(Lane a, Lane b) { return a < b ? a : b; }
BINOCAL_INLINE Lane max_of(Lane a, Lane b) { return a > b ? a : b; }
BINOCAL_INLINE Lane with_sign_of(Lane a, Lane b) {
    return (Lane)(((LaneInt)a & 0x7fffffff) | ((LaneInt)b & (std::int32_t)0x80000000));
}
BINOCAL_INLINE Lane absolute(Lane a) { return (Lane)((LaneInt)a & 0x7fffffff); }
// exp for x in [-87, 0]: 2^k e^r with |r| <= ln 2 / 2 and a polynomial of degree 5; relative error 3e-6.
BINOCAL_INLINE Lane exponential(Lane x) {
    x = max_of(x, splat(-87.0f));
    Lane magic = splat(12582912.0f);  // 1.5 * 2^23: adding it rounds to a whole number
    Lane shifted = x * splat(1.44269504f) + magic;
    Lane k = shifted - magic;
    Lane r = x - k * splat(0.693147181f);
    Lane p = splat(1.0f / 120) * r + splat(1.0f / 24);
    p = p * r + splat(1.0f / 6);
    p = p * r + splat(0.5f);
    p = p * r + splat(1.0f);
    p = p * r + splat(1.0f);
    LaneInt exponent = ((LaneInt)shifted - (LaneInt)magic + 127) << 23;
    return p * (Lane)exponent;
}
#endif

BINOCAL_INLINE Lane load(const float* from) {
    Lane value;
    std::memcpy(&value, from, sizeof(Lane));
    return value;
}
BINOCAL_INLINE void store(float* to, Lane value) { std::memcpy(to, &value, sizeof(Lane)); }
BINOCAL_INLINE Lane constant(double value) { return splat(static_cast<float>(value)); }
BINOCAL_INLINE Lane square_root(Lane a) {
    float values[kLanes];
    store(values, a);
    for (int i = 0; i < kLanes; ++i) values[i] = std::sqrt(values[i]);
    return load(values);
}
BINOCAL_INLINE float least_of(Lane a) {
    float values[kLanes];
    store(values, a);
    for (int i = 4; i > 0; i /= 2)
        for (int j = 0; j < i; ++j) values[j] = values[j] < values[j + i] ? values[j] : values[j + i];
    return values[0];
}

BINOCAL_INLINE float sum_of(const Lane& a) {
    float values[kLanes], s = 0;
    store(values, a);
    for (float value : values) s += value;
    return s;
}

// erf(x / sqrt 2) from x and exp(-x^2 / 2). Abramowitz & Stegun 7.1.26, error below 1.5e-7.
BINOCAL_INLINE Lane error_function(Lane x, Lane gauss) {
    Lane z = absolute(x) * splat(0.70710678f);
    Lane t = splat(1.0f) / (splat(1.0f) + splat(0.3275911f) * z);
    Lane p = splat(1.061405429f) * t - splat(1.453152027f);
    p = p * t + splat(1.421413741f);
    p = p * t - splat(0.284496736f);
    p = p * t + splat(0.254829592f);
    return with_sign_of(splat(1.0f) - p * t * gauss, x);
}

constexpr float kFar = 5.0f;  // sigmas: beyond it 6e-7 of the contrast is left

// E[max(n - distance, 0)] of a normal n with mean 0: what an end of the range takes away that lies so far off; and the share beyond it.
BINOCAL_INLINE Lane clipped_away(Lane distance, Lane noise, Lane over_noise, Lane& beyond) {
    const Lane far = splat(8.0f), zero = splat(0.0f);
    const Lane z = min_of(max_of(distance * over_noise, zero - far), far);
    const Lane gauss = exponential(splat(-0.5f) * z * z);
    beyond = splat(0.5f) - splat(0.5f) * error_function(z, gauss);
    return max_of(noise * (splat(0.39894228f) * gauss - z * beyond), zero - distance);
}

// Fill the Jacobian's columns, the residual's and the weights; each column is multiplied by the root of the weight. Where values are
// clipped the weights kept are those of the pixels whose noise is not.
template <bool is_bent, bool is_clipped>
inline void linearize_as(Workspace& work, const double* p, const Region& region, const Clipping& clipping) {
    const Patch& patch = work.patch;
    double s1 = std::exp(-p[kBlur1]), s2 = std::exp(-p[kBlur2]);
    double c1 = std::cos(p[kAngle1]), n1 = std::sin(p[kAngle1]), c2 = std::cos(p[kAngle2]), n2 = std::sin(p[kAngle2]);
    double rho = c1 * c2 + n1 * n2, skew = n1 * c2 - c1 * n2;  // cosine and sine of angle1 - angle2
    const double rest = std::sqrt(std::max(1 - rho * rho, 1e-4));
    const Quadrature& rule = quadrature_for(rho);
    double arc = std::asin(rho);
    Lane sine[6], half_secant[6], share[6];
    for (int k = 0; k < rule.n; ++k) {
        double t = arc * rule.node[k], c = std::cos(t);
        sine[k] = splat(static_cast<float>(2 * std::sin(t)));
        half_secant[k] = splat(static_cast<float>(-0.5 / (c * c)));
        share[k] = splat(static_cast<float>(2 / 3.14159265358979 * arc * rule.weight[k]));
    }
    const Lane fx = constant(p[kX] - patch.column), fy = constant(p[kY] - patch.row);
    const Lane normal1x = constant(-n1 * s1), normal1y = constant(c1 * s1), normal2x = constant(-n2 * s2), normal2y = constant(c2 * s2);
    const Lane along1x = constant(-c1 * s1), along1y = constant(-n1 * s1), along2x = constant(-c2 * s2), along2y = constant(-n2 * s2);
    const Lane px1 = constant(1 / s1), px2 = constant(1 / s2);
    const Lane Rho = constant(rho), Skew = constant(skew), over_rest = constant(1 / rest), half_over = constant(-0.5 / (rest * rest));
    const Lane joint = constant(4 / (2 * 3.14159265358979 * rest)), slope = constant(2 / std::sqrt(2 * 3.14159265358979));
    const Lane a = constant(p[kOffset]), b = constant(p[kContrast]), gx = constant(p[kSlopeX]), gy = constant(p[kSlopeY]), q = constant(p[kTone]);
    const Lane one = splat(1.0f), zero = splat(0.0f), far = splat(8.0f), tiny = splat(1e-30f);
    const Lane bend1 = constant(0.5 * region.bend[0] / s1), bend2 = constant(0.5 * region.bend[1] / s2);
    const Lane turn1 = constant(region.bend[0] / s1), turn2 = constant(region.bend[1] / s2);  // k sigma
    const Lane edge = constant(region.radius + 0.5), strip = constant(std::min(region.strip, 100.0) + 0.5);
    const Lane top = constant(clipping.top), bottom = constant(clipping.bottom);
    const Lane noise = constant(clipping.noise), over_noise = constant(1 / clipping.noise);
    Lane disc = zero, clear_squares = zero;
    for (int i = 0; i < patch.n_vectors; ++i) {
        const int at = i * kLanes;
        Lane u = load(patch.u + at) - fx, v = load(patch.v + at) - fy;
        Lane d1 = normal1x * u + normal1y * v, d2 = normal2x * u + normal2y * v;
        Lane turned1 = along1x * u + along1y * v, turned2 = along2x * u + along2y * v;  // -t.u / sigma
        Lane n1x = normal1x, n1y = normal1y, n2x = normal2x, n2y = normal2y, widened1 = zero, widened2 = zero;
        if constexpr (is_bent) {
            n1x = n1x - turn1 * turned1 * along1x, n1y = n1y - turn1 * turned1 * along1y;
            n2x = n2x - turn2 * turned2 * along2x, n2y = n2y - turn2 * turned2 * along2y;
            const Lane straight1 = d1, straight2 = d2;
            d1 = d1 - bend1 * (turned1 * turned1 + one), d2 = d2 - bend2 * (turned2 * turned2 + one);
            turned1 = turned1 * (one + turn1 * straight1), turned2 = turned2 * (one + turn2 * straight2);
            widened1 = turn1, widened2 = turn2;
        }
        // The weight: a disc with an edge one pixel wide, cut to bands along the edges. Its root multiplies the columns.
        Lane r2 = u * u + v * v;
        Lane distance = square_root(r2);
        Lane band = min_of(absolute(d1) * px1, absolute(d2) * px2);
        Lane weight = min_of(max_of(edge - distance, zero), one) * min_of(max_of(strip - band, zero), one);
        store(work.weights + at, weight);
        Lane root = square_root(weight);

        d1 = min_of(max_of(d1, zero - far), far);
        d2 = min_of(max_of(d2, zero - far), far);
        Lane F1 = zero, F2 = zero, Fr = zero, F = with_sign_of(one, d1 * d2);
        Lane size1 = absolute(d1), size2 = absolute(d2);
        if (least_of(min_of(size1, size2)) < kFar) {  // else all of these pixels are plain black or white
            Lane e1 = exponential(splat(-0.5f) * d1 * d1), e2 = exponential(splat(-0.5f) * d2 * d2);
            Lane E1 = error_function(d1, e1), E2 = error_function(d2, e2);
            F = E1 * E2;
            if (least_of(max_of(size1, size2)) < kFar) {
                Lane squares = d1 * d1 + d2 * d2, product = d1 * d2;
                for (int k = 0; k < rule.n; ++k) {
                    F = F + share[k] * exponential((squares - sine[k] * product) * half_secant[k]);
                }
                Lane both = exponential((squares - splat(2.0f) * Rho * product) * half_over);
                F1 = slope * e1 * error_function((d2 - Rho * d1) * over_rest, min_of(both / (e1 + tiny), one));
                F2 = slope * e2 * error_function((d1 - Rho * d2) * over_rest, min_of(both / (e2 + tiny), one));
                Fr = joint * both;
            } else {  // each of these pixels sees one edge at most
                F1 = slope * e1 * E2;
                F2 = slope * e2 * E1;
            }
        }

        Lane light = one + gx * u + gy * v;
        Lane G = F + q * (one - F * F);
        Lane print = a + b * G;
        Lane grey = print * light;
        if constexpr (is_clipped) {
            Lane above, below;
            grey = grey - clipped_away(top - grey, noise, over_noise, above) + clipped_away(grey - bottom, noise, over_noise, below);
            Lane seen = max_of(one - above - below, zero);
            Lane clear = min_of(max_of((seen - splat(kClear)) * splat(2 / (1 - kClear)), zero), one);
            Lane residual = root * (load(patch.value + at) - grey);
            store(work.columns[kParameters] + at, residual);
            store(work.weights + at, weight * clear);
            disc = disc + weight;
            clear_squares = clear_squares + residual * residual * clear;
            root = root * seen;
        } else {
            store(work.columns[kParameters] + at, root * (load(patch.value + at) - grey));
        }
        Lane gain = root * light * b * (one - splat(2.0f) * q * F);
        F1 = F1 * gain;
        F2 = F2 * gain;
        Fr = Fr * gain;
        store(work.columns[kX] + at, zero - (F1 * n1x + F2 * n2x + root * print * gx));
        store(work.columns[kY] + at, zero - (F1 * n1y + F2 * n2y + root * print * gy));
        store(work.columns[kAngle1] + at, F1 * turned1 - Fr * Skew);
        store(work.columns[kAngle2] + at, F2 * turned2 + Fr * Skew);
        store(work.columns[kBlur1] + at, zero - F1 * (d1 + widened1));
        store(work.columns[kBlur2] + at, zero - F2 * (d2 + widened2));
        store(work.columns[kOffset] + at, root * light);
        store(work.columns[kContrast] + at, root * light * G);
        store(work.columns[kSlopeX] + at, root * print * u);
        store(work.columns[kSlopeY] + at, root * print * v);
        store(work.columns[kTone] + at, root * light * b * (one - F * F));
    }
    if constexpr (is_clipped) {
        work.disc = sum_of(disc);
        work.clear_squares = sum_of(clear_squares);
    }
}

inline void linearize(Workspace& work, const double* p, const Region& region, const Clipping& clipping) {
    const bool is_straight = region.bend[0] == 0 && region.bend[1] == 0;
    if (work.patch.is_clipped)
        return is_straight ? linearize_as<false, true>(work, p, region, clipping) : linearize_as<true, true>(work, p, region, clipping);
    is_straight ? linearize_as<false, false>(work, p, region, clipping) : linearize_as<true, false>(work, p, region, clipping);
}

inline void multiply(const Workspace& work, Equations& out) {
    constexpr int tile = 3;
    const int n = work.patch.n_vectors;
    for (int i = 0; i < kColumns; i += tile) {
        for (int j = i; j < kColumns; j += tile) {
            Lane sum[tile][tile];
            for (auto& row : sum)
                for (auto& value : row) value = splat(0.0f);
            for (int k = 0; k < n; ++k) {
                Lane right[tile];
                for (int t = 0; t < tile; ++t) right[t] = load(work.columns[j + t] + k * kLanes);
                for (int s = 0; s < tile; ++s) {
                    Lane left = load(work.columns[i + s] + k * kLanes);
                    for (int t = 0; t < tile; ++t) sum[s][t] = sum[s][t] + left * right[t];
                }
            }
            for (int s = 0; s < tile; ++s)
                for (int t = 0; t < tile; ++t) out.gram[i + s][j + t] = out.gram[j + t][i + s] = sum_of(sum[s][t]);
        }
    }
    Lane total = splat(0.0f);
    for (int k = 0; k < n; ++k) {
        total = total + load(work.weights + k * kLanes);
    }
    out.weight_sum = sum_of(total);
}

// What each pixel's residual moves the corner by in two directions, and the sums of squares of what a grey level does.
inline void moves(Workspace& work, const float (&step)[2][kParameters], float (&squares)[2]) {
    Lane sum[2] = {splat(0.0f), splat(0.0f)};
    for (int i = 0; i < work.patch.n_vectors; ++i) {
        const int at = i * kLanes;
        Lane gain[2] = {splat(0.0f), splat(0.0f)};
        for (int j = 0; j < kParameters; ++j) {
            Lane column = load(work.columns[j] + at);
            for (int k : {0, 1}) gain[k] = gain[k] + splat(step[k][j]) * column;
        }
        Lane weight = load(work.weights + at), residual = load(work.columns[kParameters] + at);
        for (int k : {0, 1}) {
            sum[k] = sum[k] + gain[k] * gain[k] * weight;
            store(work.moves[k] + at, gain[k] * residual);
        }
    }
    for (int k : {0, 1}) squares[k] = sum_of(sum[k]);
}

// Sum of the products of all pairs of pixels at most kNear apart in x and in y, each pixel with itself too, and with those near
// the point opposite it (whole pixels twice the corner's place).
inline float near_products(const Workspace& work, const float* values, int twice_x, int twice_y) {
    constexpr int middle = kMaxRadius + 1 + kNear, width = (kSide + 2 * kNear + kLanes - 1) / kLanes * kLanes;
    static_assert(kNear == 2);  // five lines are added by name
    alignas(32) float one[kSide + 2 * kNear][width] = {}, grid[kSide + 2 * kNear][width] = {}, sums[width + 2 * kNear] = {}, total[width] = {};
    const Patch& patch = work.patch;
    for (int row = 0; row < patch.n_rows; ++row) {
        const auto& r = patch.rows[row];
        const float* from = values + r.first;
        float *own = one[middle + r.v] + middle + r.u, *here = grid[middle + r.v] + middle + r.u;
        float* opposite = grid[middle + twice_y - r.v] + middle + twice_x - r.u;
        for (int i = 0; i < r.n; ++i) own[i] = from[i];
        for (int i = 0; i < r.n; ++i) here[i] += from[i];
        for (int i = 0; i < r.n; ++i) opposite[-i] += from[i];
    }
    const int reach = std::min(kMaxRadius + 1, static_cast<int>(patch.radius) + 2);
    for (int y = middle - reach; y <= middle + reach; ++y) {
        for (int x = 0; x < width; ++x) sums[x + kNear] = grid[y - 2][x] + grid[y - 1][x] + grid[y][x] + grid[y + 1][x] + grid[y + 2][x];
        for (int x = 0; x < width; ++x) total[x] += (sums[x] + sums[x + 1] + sums[x + 2] + sums[x + 3] + sums[x + 4]) * one[y][x];
    }
    float sum = 0;
    for (float value : total) sum += value;
    return sum;
}
