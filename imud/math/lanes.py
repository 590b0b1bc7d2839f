"""Several covariances of the same states at once, beside each other: `kalman` for S[element of the triangle, lane].

Each lane has the bits that `kalman` gives it. Four lanes are one vector of a processor with AVX2: four covariances then
cost as much as one. All lanes are read before any is written, which the compiler has to know.

Source: as `kalman`.
"""

from ..compile.jit import kernel, unrolled, written_out
from .arrays import Floats, Indices, Reals, Tensor
from .kalman import packed_index

LANES = 4


@unrolled
def add_scaled(S: Tensor, to: int, at: int, a: float) -> None:
    """Row `to` gains `a` times row `at`."""
    w, x, y, z = a * S[at, 0], a * S[at, 1], a * S[at, 2], a * S[at, 3]
    S[to, 0] += w
    S[to, 1] += x
    S[to, 2] += y
    S[to, 3] += z


@unrolled
def add_scaled3(S: Tensor, to: int, at: tuple[int, int, int], a: float, b: float, c: float) -> None:
    """Row `to` gains a, b, c times the three rows `at`."""
    i, j, k = at
    w, x = a * S[i, 0] + b * S[j, 0] + c * S[k, 0], a * S[i, 1] + b * S[j, 1] + c * S[k, 1]
    y, z = a * S[i, 2] + b * S[j, 2] + c * S[k, 2], a * S[i, 3] + b * S[j, 3] + c * S[k, 3]
    S[to, 0] += w
    S[to, 1] += x
    S[to, 2] += y
    S[to, 3] += z


@unrolled
def shear(S: Tensor, n: int, i: int, j: int, a: float) -> None:
    """State i gains `a` times state j: see `kalman.shear`."""
    ii, ij, jj = packed_index(n, i, i), packed_index(n, i, j), packed_index(n, j, j)
    w, x = a * (2.0 * S[ij, 0] + a * S[jj, 0]), a * (2.0 * S[ij, 1] + a * S[jj, 1])
    y, z = a * (2.0 * S[ij, 2] + a * S[jj, 2]), a * (2.0 * S[ij, 3] + a * S[jj, 3])
    for k in written_out(n):
        if k != i:
            add_scaled(S, packed_index(n, k, i), packed_index(n, k, j), a)
    S[ii, 0] += w
    S[ii, 1] += x
    S[ii, 2] += y
    S[ii, 3] += z


@unrolled
def shear3(S: Tensor, n: int, i: int, j: int, a: float, b: float, c: float) -> None:
    """State i gains a, b, c times the states j, j + 1, j + 2: see `kalman.shear3`."""
    own = (packed_index(n, i, j), packed_index(n, i, j + 1), packed_index(n, i, j + 2))
    add_scaled3(S, packed_index(n, i, i), own, a, b, c)
    for k in written_out(n):
        if k != i:
            others = (packed_index(n, k, j), packed_index(n, k, j + 1), packed_index(n, k, j + 2))
            add_scaled3(S, packed_index(n, k, i), others, a, b, c)
    add_scaled3(S, packed_index(n, i, i), own, a, b, c)


@unrolled
def add_product(d: Tensor, to: int, S: Tensor, at: int, value: float) -> None:
    """Row `to` of d gains `value` times row `at` of S."""
    w, x, y, z = S[at, 0] * value, S[at, 1] * value, S[at, 2] * value, S[at, 3] * value
    d[to, 0] += w
    d[to, 1] += x
    d[to, 2] += y
    d[to, 3] += z


@kernel
def measure(S: Tensor, n: int, columns: Indices, values: Floats, m: int, d: Tensor) -> None:
    """d[:n] <- S h, d[n] <- h S h', of all lanes, for the sparse row h: see `kalman.measure`."""
    for i in range(n + 1):
        d[i, 0] = d[i, 1] = d[i, 2] = d[i, 3] = 0.0
    for k in range(m):
        at = columns[k]  # of element (i, column), down the column, then along the row
        for i in range(n):
            add_product(d, i, S, at, values[k])
            at += n - 1 - i if i < columns[k] else 1
    for k in range(m):
        add_product(d, n, d, columns[k], values[k])


@unrolled
def subtract_scaled(S: Tensor, to: int, row: Reals, a: float) -> None:
    """Row `to` loses `a` times a row of all lanes."""
    w, x, y, z = row[0] * a, row[1] * a, row[2] * a, row[3] * a
    S[to, 0] -= w
    S[to, 1] -= x
    S[to, 2] -= y
    S[to, 3] -= z


@kernel
def subtract_update(S: Tensor, n: int, gain: Tensor, d: Tensor, v: Floats) -> None:
    """S -= gain d' + d gain' - v gain gain', of all lanes: Joseph's form without noise, where d = S h and v = h S h'.

    gain: the same in all lanes.
    """
    i = j = 0
    for at in range(n * (n + 1) // 2):
        w, x = gain[i, 0] * gain[j, 0] * v[0], gain[i, 1] * gain[j, 1] * v[1]
        y, z = gain[i, 2] * gain[j, 2] * v[2], gain[i, 3] * gain[j, 3] * v[3]
        w, x = w - gain[i, 0] * d[j, 0] - d[i, 0] * gain[j, 0], x - gain[i, 1] * d[j, 1] - d[i, 1] * gain[j, 1]
        y, z = y - gain[i, 2] * d[j, 2] - d[i, 2] * gain[j, 2], z - gain[i, 3] * d[j, 3] - d[i, 3] * gain[j, 3]
        S[at, 0] += w
        S[at, 1] += x
        S[at, 2] += y
        S[at, 3] += z
        j += 1
        if j == n:
            i += 1
            j = i
