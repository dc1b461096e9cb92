"""Vector algebra on tuples: 3-vectors, rotations as nine numbers row by row, symmetric matrices as six.

Tuples live in registers; the compiler removes them.  Symmetric order: xx xy xz yy yz zz.
"""

from ..compile.jit import inline
from ..compile.lanes import select


@inline
def vector(a):
    """Return the three numbers of an array."""
    return (a[0], a[1], a[2])


@inline
def load3(W, i, k):
    """Return three numbers of row i from column k on."""
    return (W[i, k], W[i, k + 1], W[i, k + 2])


@inline
def store3(W, i, k, a):
    """Write three numbers into row i from column k on."""
    W[i, k] = a[0]
    W[i, k + 1] = a[1]
    W[i, k + 2] = a[2]


@inline
def load6(W, i, k):
    """Return six numbers of row i from column k on."""
    return (W[i, k], W[i, k + 1], W[i, k + 2], W[i, k + 3], W[i, k + 4], W[i, k + 5])


@inline
def load9(W, i, k):
    """Return nine numbers of row i from column k on."""
    return load6(W, i, k) + load3(W, i, k + 6)


@inline
def store9(W, i, k, a):
    """Write nine numbers into row i from column k on."""
    store3(W, i, k, a[:3])
    store3(W, i, k + 3, a[3:6])
    store3(W, i, k + 6, a[6:])


@inline
def accumulate3(W, i, k, first, a):
    """Add three numbers to row i from column k on, or write them, if they are the first."""
    if first:
        store3(W, i, k, a)
    else:
        store3(W, i, k, add(load3(W, i, k), a))


@inline
def add(a, b):
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inline
def sub(a, b):
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@inline
def scale(a, k):
    """Return k a."""
    return (a[0] * k, a[1] * k, a[2] * k)


@inline
def choose(mask, a, b):
    """Return `a` where `mask` holds, else `b`."""
    return (select(mask, a[0], b[0]), select(mask, a[1], b[1]), select(mask, a[2], b[2]))


@inline
def dot(a, b):
    """Return a' b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def cross(a, b):
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inline
def rotate(E, a):
    """Return E a."""
    return (
        E[0] * a[0] + E[1] * a[1] + E[2] * a[2],
        E[3] * a[0] + E[4] * a[1] + E[5] * a[2],
        E[6] * a[0] + E[7] * a[1] + E[8] * a[2],
    )


@inline
def rotate_back(E, a):
    """Return E' a."""
    return (
        E[0] * a[0] + E[3] * a[1] + E[6] * a[2],
        E[1] * a[0] + E[4] * a[1] + E[7] * a[2],
        E[2] * a[0] + E[5] * a[1] + E[8] * a[2],
    )


@inline
def compose(E, B):
    """Return E B of two rotations."""
    x = rotate(E, (B[0], B[3], B[6]))
    y = rotate(E, (B[1], B[4], B[7]))
    z = rotate(E, (B[2], B[5], B[8]))
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])


@inline
def symmetric(J, a):
    """Return J a of a symmetric matrix."""
    return (
        J[0] * a[0] + J[1] * a[1] + J[2] * a[2],
        J[1] * a[0] + J[3] * a[1] + J[4] * a[2],
        J[2] * a[0] + J[4] * a[1] + J[5] * a[2],
    )


@inline
def congruence(E, J):
    """Return E J E' of a symmetric matrix."""
    x = symmetric(J, (E[0], E[1], E[2]))
    y = symmetric(J, (E[3], E[4], E[5]))
    z = symmetric(J, (E[6], E[7], E[8]))
    return (
        E[0] * x[0] + E[1] * x[1] + E[2] * x[2],
        E[3] * x[0] + E[4] * x[1] + E[5] * x[2],
        E[6] * x[0] + E[7] * x[1] + E[8] * x[2],
        E[3] * y[0] + E[4] * y[1] + E[5] * y[2],
        E[6] * y[0] + E[7] * y[1] + E[8] * y[2],
        E[6] * z[0] + E[7] * z[1] + E[8] * z[2],
    )


@inline
def about_origin(J, m, c):
    """Return the inertia J about the center of mass c moved to the origin: J + m (c'c 1 - c c')."""
    x, y, z = c[0] * m, c[1] * m, c[2] * m
    xx, yy, zz = x * c[0], y * c[1], z * c[2]
    return (
        J[0] + (yy + zz),
        J[1] - x * c[1],
        J[2] - x * c[2],
        J[3] + (xx + zz),
        J[4] - y * c[2],
        J[5] + (xx + yy),
    )


@inline
def solve6(J, H, M, n, f):
    """Solve [[J, H], [H', M]] x = [n; f] for a positive definite matrix: M by blocks, then 3 x 3."""
    x, y, z = (H[0], H[1], H[2]), (H[3], H[4], H[5]), (H[6], H[7], H[8])
    L = _factor3(M)
    Mx, My, Mz, Mf = _solve3(L, x), _solve3(L, y), _solve3(L, z), _solve3(L, f)
    K = (
        J[0] - dot(x, Mx),
        J[1] - dot(x, My),
        J[2] - dot(x, Mz),
        J[3] - dot(y, My),
        J[4] - dot(y, Mz),
        J[5] - dot(z, Mz),
    )
    a = _solve3(_factor3(K), (n[0] - dot(x, Mf), n[1] - dot(y, Mf), n[2] - dot(z, Mf)))
    b = sub(Mf, add(scale(Mx, a[0]), add(scale(My, a[1]), scale(Mz, a[2]))))
    return (a[0], a[1], a[2], b[0], b[1], b[2])


@inline
def _factor3(M):
    """Factor a symmetric positive definite 3 x 3 matrix as L D L': (l21, l31, l32, 1/d1, 1/d2, 1/d3)."""
    e1 = 1.0 / M[0]
    l21, l31 = M[1] * e1, M[2] * e1
    e2 = 1.0 / (M[3] - l21 * M[1])
    w = M[4] - l31 * M[1]
    l32 = w * e2
    e3 = 1.0 / (M[5] - l31 * M[2] - l32 * w)
    return (l21, l31, l32, e1, e2, e3)


@inline
def _solve3(L, b):
    y2 = b[1] - L[0] * b[0]
    y3 = b[2] - L[1] * b[0] - L[2] * y2
    x3 = y3 * L[5]
    x2 = y2 * L[4] - L[2] * x3
    return (b[0] * L[3] - L[0] * x2 - L[1] * x3, x2, x3)
