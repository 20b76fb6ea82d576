import math

import numpy as np
import pytest

from roadsight.scene.pavement.fpfh import FEATURES, fpfh, nearest_neighbours, upward_normals


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def literal_angles(p, n, q, m):
    """Rusu's pair: source = the point whose normal is nearer to the line; Darboux frame u, v, w.

    Where both are equally near, the point whose histogram it is remains the source.
    """
    line = [b - a for a, b in zip(p, q, strict=True)]
    length = math.sqrt(dot(line, line))
    if length == 0:
        return None
    line = [a / length for a in line]
    turned = abs(dot(m, line)) - abs(dot(n, line)) > 1e-9
    source, target = (m, n) if turned else (n, m)
    line = [-a for a in line] if turned else line
    u = source
    v = cross(line, u)
    if math.sqrt(dot(v, v)) == 0:
        return None
    v = [a / math.sqrt(dot(v, v)) for a in v]
    w = cross(u, v)
    alpha, phi = dot(v, target), dot(u, line)
    theta = math.atan2(dot(w, target), dot(u, target))
    return theta, alpha, phi


def literal_histogram(xyz, normals, i, neighbours):
    """Share of the neighbours in each bin, in percent: theta, alpha, phi, 11 bins each."""
    histogram = [0.0] * 33
    present = [j for j in neighbours if j >= 0]
    if math.isnan(normals[i][0]):
        return histogram
    for j in present:
        angles = None
        if not math.isnan(normals[j][0]):
            angles = literal_angles(xyz[i], normals[i], xyz[j], normals[j])
        if angles is None:
            continue
        theta, alpha, phi = angles
        shares = ((theta + math.pi) / (2 * math.pi), (alpha + 1) / 2, (phi + 1) / 2)
        for third, share in enumerate(shares):
            position = min(10, max(0, math.floor(11 * share)))
            histogram[11 * third + position] += 100 / len(present)
    return histogram


def literal_fpfh(xyz, normals, neighbours):
    """FPFH(p) = SPFH(p) + the neighbours' mean weighted by 1 / distance squared, scaled to 100."""
    xyz, normals = xyz.tolist(), normals.tolist()
    simple = [literal_histogram(xyz, normals, i, near) for i, near in enumerate(neighbours)]
    out = []
    for i, near in enumerate(neighbours):
        mixed = [0.0] * 33
        for j in near:
            if j < 0:
                continue
            squared = sum((a - b) ** 2 for a, b in zip(xyz[i], xyz[j], strict=True))
            if squared > 0:
                mixed = [m + s / squared for m, s in zip(mixed, simple[j], strict=True)]
        for third in range(3):
            part = slice(11 * third, 11 * third + 11)
            total = sum(mixed[part])
            if total > 0:
                mixed[part] = [100 * m / total for m in mixed[part]]
        out.append([s + m for s, m in zip(simple[i], mixed, strict=True)])
    return np.array(out)


def described(xyz, k=10):
    distance, near = nearest_neighbours(xyz, k)
    normals, _ = upward_normals(xyz, near)
    return normals, near, fpfh(xyz, normals, distance, near)


@pytest.mark.parametrize("height", [0.0, 0.02, 0.3, 3.0])
@pytest.mark.parametrize("k", [3, 10])
def test_equals_a_literal_transcription(rng, height, k):
    xyz = rng.uniform(0, 3, (150, 3)) * [1, 1, height] + [40, -20, 7]
    normals, near, found = described(xyz, k)
    np.testing.assert_allclose(found, literal_fpfh(xyz, normals, near), rtol=1e-5, atol=1e-4)


def test_equals_a_literal_transcription_with_arbitrary_normals(rng):
    xyz = rng.normal(size=(120, 3))
    normals = rng.normal(size=(120, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distance, near = nearest_neighbours(xyz, 8)
    found = fpfh(xyz, normals, distance, near)
    np.testing.assert_allclose(found, literal_fpfh(xyz, normals, near), rtol=1e-5, atol=1e-4)


def test_equals_a_literal_transcription_with_duplicates_and_missing_normals(rng):
    xyz = rng.uniform(0, 1, (80, 3))
    xyz = np.concatenate([xyz, xyz[:15], xyz[:5]])
    distance, near = nearest_neighbours(xyz, 6)
    near[3, 4:], distance[3, 4:] = -1, np.inf
    normals, _ = upward_normals(xyz, near)
    normals[10:20] = np.nan
    found = fpfh(xyz, normals, distance, near)
    np.testing.assert_allclose(found, literal_fpfh(xyz, normals, near), rtol=1e-5, atol=1e-4)


def test_a_flat_road_fills_the_middle_bins_by_hand():
    x, y = np.indices((6, 6)).reshape(2, -1).astype(float)
    xyz = np.column_stack([x, y, np.zeros(36)])
    expected = np.zeros(FEATURES)
    expected[[5, 16, 27]] = 200.0  # own histogram and the neighbours', all angles zero
    assert (described(xyz, 4)[2] == expected).all()


def test_each_third_sums_to_200_where_all_pairs_are_usable(rng):
    found = described(rng.uniform(0, 2, (300, 3)))[2].astype(float)
    sums = found.reshape(-1, 3, 11).sum(axis=2)
    np.testing.assert_allclose(sums, 200.0, rtol=1e-5)


def test_points_without_a_usable_pair_are_all_zero():
    xyz = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [9, 9, 9]])
    normals, _, found = described(xyz, 2)
    assert np.isnan(normals[:3]).all()
    assert (found[:3] == 0).all()
    assert (fpfh(xyz[:1], np.array([[0, 0, 1.0]]), *nearest_neighbours(xyz[:1], 3)) == 0).all()


def test_a_pair_along_its_normal_has_no_frame():
    xyz = np.array([[0.0, 0, 0], [0, 0, 1]])
    normals = np.array([[0.0, 0, 1], [0, 0, 1]])
    assert (fpfh(xyz, normals, *nearest_neighbours(xyz, 1)) == 0).all()


def test_no_points():
    found = fpfh(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 4), np.int64))
    assert found.shape == (0, FEATURES)


def test_flipped_normals_would_change_the_features(rng):
    """Why normals are oriented first: a random half turned over changes most histograms."""
    xyz = rng.uniform(0, 5, (400, 3)) * [1, 1, 0.05]
    distance, near = nearest_neighbours(xyz, 10)
    normals, _ = upward_normals(xyz, near)
    flipped = normals * rng.choice([-1, 1], (400, 1))
    straight = fpfh(xyz, normals, distance, near)
    changed = np.abs(fpfh(xyz, flipped, distance, near) - straight).sum(axis=1)
    assert np.median(changed) > 100  # of 600
