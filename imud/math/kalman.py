"""Covariance arithmetic on a packed upper triangle: symmetric by construction, no temporaries.

A symmetric n x n matrix P is kept as a flat array of n (n + 1) / 2 numbers, rows of the upper triangle one after
another. A sparse transition Phi is applied as a product of elementary matrices, each of which is a congruence
P <- E P E' and so keeps P positive semidefinite. Measurements are fused one scalar at a time by the conventional
update P <- P - (P h')(P h')' / s, which the triangle keeps symmetric. Joseph's form, (I - k h) P (I - k h)' + k r k',
is the same in exact arithmetic. It keeps P positive also where the noise variance r is less than 1e-14 of the largest
that h P h' could be with these variances; above that, to which tests hold both, rounding harms neither.

Source: Bierman, Factorization Methods for Discrete Sequential Estimation (1977), ch. II.
"""

from typing import Any

import numpy as np

from ..compile.jit import kernel, unrolled, written_out
from .arrays import Floats, Indices
from .rotation import Matrix


@kernel
def packed_index(n: int, i: int, j: int) -> int:
    """Where element (i, j) of an n x n symmetric matrix is in its packed triangle."""
    if i > j:
        i, j = j, i
    return i * n - i * (i - 1) // 2 + (j - i)


@unrolled
def shear(P: Floats, n: int, i: int, j: int, a: float) -> None:
    """P <- E P E' with E = I + a e_i e_j', i != j: state i gains `a` times state j."""
    pij = P[packed_index(n, i, j)]
    pjj = P[packed_index(n, j, j)]
    low, high = min(i, j), max(i, j)
    at_i, at_j = i, j  # of elements (k, i) and (k, j): down both columns, down one along the other's row, along both
    for k in range(low):
        P[at_i] += a * P[at_j]
        at_i += n - 1 - k
        at_j += n - 1 - k
    for k in range(low, high):
        if k != i:
            P[at_i] += a * P[at_j]
        at_i += n - 1 - k if k < i else 1
        at_j += n - 1 - k if k < j else 1
    for k in range(1 if high == i else 0, n - high):  # unsigned indices: see `update`
        P[np.uint64(at_i + k)] += a * P[np.uint64(at_j + k)]
    P[packed_index(n, i, i)] += a * (2.0 * pij + a * pjj)


@unrolled
def shear3(P: Floats, n: int, i: int, j: int, a: float, b: float, c: float) -> None:
    """P <- E P E' with E = I + e_i (a e_j + b e_j+1 + c e_j+2)', i < j: state i gains of three that follow one another.

    The same as `shear` three times, in half the instructions.
    """
    at_i, at_j = i, j  # as there, but of elements (k, i) and (k, j)
    for k in range(i):
        P[np.uint64(at_i)] += a * P[np.uint64(at_j)] + b * P[np.uint64(at_j + 1)] + c * P[np.uint64(at_j + 2)]
        at_i += n - 1 - k
        at_j += n - 1 - k
    ii, ij = np.uint64(at_i), at_j
    P[ii] += a * P[np.uint64(ij)] + b * P[np.uint64(ij + 1)] + c * P[np.uint64(ij + 2)]
    for k in range(i + 1, j):
        at_j += n - k
        P[np.uint64(at_i + k - i)] += a * P[np.uint64(at_j)] + b * P[np.uint64(at_j + 1)] + c * P[np.uint64(at_j + 2)]
    jj = at_j + n - j  # of the three diagonal elements
    kk = jj + n - j
    ll = kk + n - j - 1
    P[np.uint64(ij)] += a * P[np.uint64(jj)] + b * P[np.uint64(jj + 1)] + c * P[np.uint64(jj + 2)]
    P[np.uint64(ij + 1)] += a * P[np.uint64(jj + 1)] + b * P[np.uint64(kk)] + c * P[np.uint64(kk + 1)]
    P[np.uint64(ij + 2)] += a * P[np.uint64(jj + 2)] + b * P[np.uint64(kk + 1)] + c * P[np.uint64(ll)]
    for k in range(3, n - j):
        P[np.uint64(ij + k)] += a * P[np.uint64(jj + k)] + b * P[np.uint64(kk + k - 1)] + c * P[np.uint64(ll + k - 2)]
    P[ii] += a * P[np.uint64(ij)] + b * P[np.uint64(ij + 1)] + c * P[np.uint64(ij + 2)]


@unrolled
def shear_block(P: Floats, n: int, i: int, j: int, r: int, a: float, b: float, c: float) -> None:
    """The part of `shear33` in rows i to i + 2 and columns i to i + 2, j to j + 2, by which state i + r gains."""
    ij, ii = packed_index(n, i + r, j), packed_index(n, i + r, i + r)
    jj, kk, ll = packed_index(n, j, j), packed_index(n, j + 1, j + 1), packed_index(n, j + 2, j + 2)
    for k in range(3):
        at = packed_index(n, i + k, j)
        P[packed_index(n, i + r, i + k)] += a * P[at] + b * P[at + 1] + c * P[at + 2]
    P[ij] += a * P[jj] + b * P[jj + 1] + c * P[jj + 2]
    P[ij + 1] += a * P[jj + 1] + b * P[kk] + c * P[kk + 1]
    P[ij + 2] += a * P[jj + 2] + b * P[kk + 1] + c * P[ll]
    P[ii] += a * P[ij] + b * P[ij + 1] + c * P[ij + 2]


@unrolled
def shear33(P: Floats, n: int, i: int, j: int, A: Matrix) -> None:
    """`shear3` of states i, i + 1 and i + 2, which gain the three rows of A times the states j to j + 2; i + 3 <= j.

    The same as `shear3` three times, to the last bit, in fewer instructions.
    """
    a0, b0, c0, a1, b1, c1, a2, b2, c2 = A
    shear_block(P, n, i, j, 0, a0, b0, c0)
    shear_block(P, n, i, j, 1, a1, b1, c1)
    shear_block(P, n, i, j, 2, a2, b2, c2)
    at_i, at_j = i, j  # of elements (k, i) and (k, j), down the columns
    for k in range(i):
        x, y, z = P[np.uint64(at_j)], P[np.uint64(at_j + 1)], P[np.uint64(at_j + 2)]
        P[np.uint64(at_i)] += a0 * x + b0 * y + c0 * z
        P[np.uint64(at_i + 1)] += a1 * x + b1 * y + c1 * z
        P[np.uint64(at_i + 2)] += a2 * x + b2 * y + c2 * z
        at_i += n - 1 - k
        at_j += n - 1 - k
    i0, i1, i2 = packed_index(n, i, i) - i, packed_index(n, i + 1, i + 1) - i - 1, packed_index(n, i + 2, i + 2) - i - 2
    at_j = packed_index(n, i + 3, j)
    for k in range(i + 3, j):  # along the rows i, down the columns j
        x, y, z = P[np.uint64(at_j)], P[np.uint64(at_j + 1)], P[np.uint64(at_j + 2)]
        P[np.uint64(i0 + k)] += a0 * x + b0 * y + c0 * z
        P[np.uint64(i1 + k)] += a1 * x + b1 * y + c1 * z
        P[np.uint64(i2 + k)] += a2 * x + b2 * y + c2 * z
        at_j += n - 1 - k
    j0, j1, j2 = packed_index(n, j, j) - j, packed_index(n, j + 1, j + 1) - j - 1, packed_index(n, j + 2, j + 2) - j - 2
    for k in range(j + 3, n):  # along the rows; unsigned indices: see `update`
        x, y, z = P[np.uint64(j0 + k)], P[np.uint64(j1 + k)], P[np.uint64(j2 + k)]
        P[np.uint64(i0 + k)] += a0 * x + b0 * y + c0 * z
        P[np.uint64(i1 + k)] += a1 * x + b1 * y + c1 * z
        P[np.uint64(i2 + k)] += a2 * x + b2 * y + c2 * z


@kernel
def scale(P: Floats, n: int, i: int, a: float) -> None:
    """P <- E P E' with E the identity but for E[i, i] = a: state i decays."""
    at = i  # of element (k, i), down the column, then (i, k), along the row
    for k in range(i):
        P[np.uint64(at)] *= a
        at += n - 1 - k
    P[np.uint64(at)] *= a
    for k in range(n - i):
        P[np.uint64(at + k)] *= a


@kernel
def scale3(P: Floats, n: int, i: int, a: float) -> None:
    """`scale` of the states i, i + 1 and i + 2, to the last bit, in fewer instructions."""
    at = i  # of element (k, i), down the columns, then of the diagonal
    for k in range(i):
        P[np.uint64(at)] *= a
        P[np.uint64(at + 1)] *= a
        P[np.uint64(at + 2)] *= a
        at += n - 1 - k
    for k in range(3):
        for j in range(3 - k):  # once more, as both states decay
            P[np.uint64(at + j)] *= a
        for j in range(n - i - k):
            P[np.uint64(at + j)] *= a
        at += n - i - k


@kernel
def reset(P: Floats, n: int, i: int, variance: float) -> None:
    """Make state i independent of the others, with `variance`."""
    for k in range(n):
        P[packed_index(n, i, k)] = 0.0
    P[packed_index(n, i, i)] = variance


@kernel
def measure(P: Floats, n: int, columns: Indices, values: Floats, m: int, d: Floats) -> float:
    """d <- P h for the sparse row h (`values[k]` at `columns[k]`, k < m); returns h P h'."""
    for i in range(n):
        d[i] = 0.0
    k = 0
    while k < m:
        first = columns[k]
        at, row = first, packed_index(n, first, first)  # of element (i, first), down the column; of the diagonal
        if k + 2 < m and columns[k + 1] == first + 1 and columns[k + 2] == first + 2:  # three at once
            a, b, c = values[k], values[k + 1], values[k + 2]
            for i in range(first):
                x = d[np.uint64(i)] + P[np.uint64(at)] * a
                d[np.uint64(i)] = x + P[np.uint64(at + 1)] * b + P[np.uint64(at + 2)] * c
                at += n - 1 - i
            row1 = row + n - first
            row2 = row1 + n - first - 1
            d[first] = d[first] + P[row] * a + P[row + 1] * b + P[row + 2] * c
            d[first + 1] = d[first + 1] + P[row + 1] * a + P[row1] * b + P[row1 + 1] * c
            d[first + 2] = d[first + 2] + P[row + 2] * a + P[row1 + 1] * b + P[row2] * c
            for i in range(3, n - first):  # unsigned indices: see `update`
                x = d[np.uint64(first + i)] + P[np.uint64(row + i)] * a
                d[np.uint64(first + i)] = x + P[np.uint64(row1 + i - 1)] * b + P[np.uint64(row2 + i - 2)] * c
            k += 3
        else:
            value = values[k]
            for i in range(first):
                d[np.uint64(i)] += P[np.uint64(at)] * value
                at += n - 1 - i
            for i in range(n - first):
                d[np.uint64(first + i)] += P[np.uint64(row + i)] * value
            k += 1
    v = 0.0
    for k in range(m):
        v += values[k] * d[columns[k]]
    return v


@kernel
def predicted_variance(P: Floats, n: int, columns: Indices, values: Floats, m: int) -> float:
    """h P h' alone, without P h of all states: each pair of elements of h once."""
    v = 0.0
    for k in range(m):
        column, d = columns[k], 0.0
        for j in range(k):
            d += P[packed_index(n, column, columns[j])] * values[j]
        v += values[k] * (2.0 * d + P[packed_index(n, column, column)] * values[k])
    return v


@kernel
def update(P: Floats, n: int, x: Floats, d: Floats, s: float, z: float) -> None:
    """Fuse one scalar measurement with innovation z (h x already removed), variance s = h P h' + r and d = P h'.

    x is the error estimate so far.
    """
    first = 0
    for i in range(n):
        gain = d[i] / s
        x[i] += gain * z
        for k in range(n - i):  # unsigned indices cannot count from the end, so these loops become vector code
            P[np.uint64(first + k)] -= gain * d[np.uint64(i + k)]
        first += n - i


@unrolled
def update_by_gain(P: Floats, n: int, x: Floats, d: Floats, gain: Floats, z: float) -> None:
    """`update` where the gain d / s is known already: the same bits."""
    for i in written_out(n):
        g, first = gain[i], i * n - i * (i - 1) // 2
        for k in range(n - i):  # unsigned indices: see `update`
            P[np.uint64(first + k)] -= g * d[np.uint64(i + k)]
    for i in range(n):
        x[i] += gain[i] * z


def unpack(P: Floats, n: int) -> Any:
    """The full symmetric matrix of a packed triangle (not for kernels)."""
    full = np.zeros((n, n))
    full[np.triu_indices(n)] = P
    return full + np.triu(full, 1).T
