// Small dense linear algebra: vectors and matrices of three, Cholesky factors, elimination. Matrices are row-major.
#pragma once

#include "cpu.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace binocal {

struct Vector3 {
    double x, y, z;
};
inline Vector3 operator+(Vector3 a, Vector3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector3 operator*(double a, Vector3 b) { return {a * b.x, a * b.y, a * b.z}; }
inline Vector3 cross(Vector3 a, Vector3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline Vector3 vector3(const double* a) { return {a[0], a[1], a[2]}; }

// A x of a 3 x 3 matrix.
inline Vector3 product3(const double* A, Vector3 x) {
    return {A[0] * x.x + A[1] * x.y + A[2] * x.z, A[3] * x.x + A[4] * x.y + A[5] * x.z, A[6] * x.x + A[7] * x.y + A[8] * x.z};
}

// A B of 3 x 3 matrices; out is another one.
inline void product3(const double* A, const double* B, double* out) {
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) out[3 * i + k] = A[3 * i] * B[k] + A[3 * i + 1] * B[3 + k] + A[3 * i + 2] * B[6 + k];
    }
}

// The inverse of the symmetric [[a, b, c], [b, d, e], [c, e, f]].
BINOCAL_INLINE void inverse_symmetric3(double a, double b, double c, double d, double e, double f, double* out) {
    out[0] = d * f - e * e, out[1] = out[3] = c * e - b * f, out[2] = out[6] = b * e - c * d;
    out[4] = a * f - c * c, out[5] = out[7] = b * c - a * e, out[8] = a * d - b * b;
    const double determinant = a * out[0] + b * out[1] + c * out[2];
    for (int i = 0; i < 9; ++i) out[i] /= determinant;
}

// In place: rows (a, b) of x become Adᵀ x with Ad = [[R, 0], [hat(t) R, R]], the adjoint of a rigid transform.
BINOCAL_INLINE void adjoint_transposed(const double* R, const double* t, double* x) {
    const double a0 = x[0] - (t[1] * x[5] - t[2] * x[4]), a1 = x[1] - (t[2] * x[3] - t[0] * x[5]),
                 a2 = x[2] - (t[0] * x[4] - t[1] * x[3]), b0 = x[3], b1 = x[4], b2 = x[5];
    for (int i = 0; i < 3; ++i) {
        x[i] = R[i] * a0 + R[3 + i] * a1 + R[6 + i] * a2;
        x[3 + i] = R[i] * b0 + R[3 + i] * b1 + R[6 + i] * b2;
    }
}

// Lower Cholesky factor of the n x n matrix A, both with rows `stride` apart, L with its diagonal inverted; L may be A. False
// where a pivot is not greater than `least_share` of its diagonal entry.
BINOCAL_INLINE bool cholesky(const double* A, double* L, int n, int stride, double least_share) {
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = A[i * stride + j];
            for (int k = 0; k < j; ++k) sum -= L[i * stride + k] * L[j * stride + k];
            if (i == j) {
                if (!(sum > least_share * A[i * stride + i])) return false;
                L[i * stride + i] = 1 / std::sqrt(sum);
            } else {
                L[i * stride + j] = sum * L[j * stride + j];
            }
        }
    }
    return true;
}

// L x = b for a factor of `cholesky`; x may be b.
BINOCAL_INLINE void solve_lower(const double* L, int n, int stride, const double* b, double* x) {
    for (int i = 0; i < n; ++i) {
        double sum = b[i];
        for (int k = 0; k < i; ++k) sum -= L[i * stride + k] * x[k];
        x[i] = sum * L[i * stride + i];
    }
}

// Lᵀ x = b, in place.
BINOCAL_INLINE void solve_upper(const double* L, int n, int stride, double* x) {
    for (int i = n - 1; i >= 0; --i) {
        double sum = x[i];
        for (int k = i + 1; k < n; ++k) sum -= L[k * stride + i] * x[k];
        x[i] = sum * L[i * stride + i];
    }
}

// x = A⁻¹ b by elimination with partial pivoting; false where A is singular. A and x (b at first) are overwritten.
BINOCAL_INLINE bool eliminate(double* A, double* x, int n, double& least_pivot) {
    least_pivot = std::numeric_limits<double>::infinity();
    for (int column = 0; column < n; ++column) {
        int pivot = column;
        for (int row = column + 1; row < n; ++row) {
            if (std::abs(A[row * n + column]) > std::abs(A[pivot * n + column])) pivot = row;
        }
        if (!(std::abs(A[pivot * n + column]) > 0)) return false;
        least_pivot = std::min(least_pivot, std::abs(A[pivot * n + column]));
        if (pivot != column) {
            for (int k = column; k < n; ++k) std::swap(A[pivot * n + k], A[column * n + k]);
            std::swap(x[pivot], x[column]);
        }
        const double inverse = 1 / A[column * n + column];
        for (int row = column + 1; row < n; ++row) {
            const double factor = A[row * n + column] * inverse;
            if (factor == 0) continue;
            for (int k = column + 1; k < n; ++k) A[row * n + k] -= factor * A[column * n + k];
            x[row] -= factor * x[column];
        }
    }
    for (int row = n - 1; row >= 0; --row) {
        for (int k = row + 1; k < n; ++k) x[row] -= A[row * n + k] * x[k];
        x[row] /= A[row * n + row];
    }
    return true;
}

}  // namespace binocal
