import numpy as np
import pytest

from roadsight.scene.grids import Grid, fill_gaps, lowest_per_cell, sample_bilinear


class TestGrid:
    def test_lines_lie_on_multiples_of_the_cell_also_below_zero(self):
        grid = Grid.over(-0.7, 0.1, 1.2, 0.9, 0.5)
        assert (grid.west, grid.south, grid.columns, grid.rows) == (-2, 0, 5, 2)
        assert (grid.west_m, grid.north_m) == (-1.0, 1.0)
        assert grid.shape == (2, 5)

    def test_a_point_on_a_line_belongs_to_the_north_eastern_cell(self):
        grid = Grid.over(0, 0, 2, 2, 1.0)
        assert grid.shape == (3, 3)
        column, row = grid.indices([0.0, 1.0, 2.0], [2.0, 1.0, 0.0])
        assert column.tolist() == [0, 1, 2]
        assert row.tolist() == [2, 1, 0]

    def test_points_outside_get_the_border_cell(self):
        grid = Grid.over(0, 0, 1.5, 0.5, 1.0)
        column, row = grid.indices([-9.0, 9.0], [9.0, -9.0])
        assert column.tolist() == [0, 1]
        assert row.tolist() == [0, 0]

    def test_flat_is_row_major_and_centres_lead_back(self, rng):
        grid = Grid.over(-3.2, 4.1, 5.7, 9.9, 0.7)
        columns, rows = np.meshgrid(np.arange(grid.columns), np.arange(grid.rows))
        x, y = grid.centres(columns.ravel(), rows.ravel())
        assert grid.flat(x, y).tolist() == list(range(grid.columns * grid.rows))

    def test_every_point_lies_in_the_grid_around_it(self, rng):
        x, y = rng.uniform(-1e4, 1e4, (2, 5000))
        grid = Grid.around(x, y, 0.3)
        column, row = grid.indices(x, y)
        cx, cy = grid.centres(column, row)
        assert np.abs(cx - x).max() <= 0.15 + 1e-9
        assert np.abs(cy - y).max() <= 0.15 + 1e-9

    def test_tiles_of_one_site_agree_on_their_cells(self, rng):
        x, y = rng.uniform(0, 100, (2, 1000))
        whole, part = Grid.around(x, y, 0.2), Grid.around(x[:50], y[:50], 0.2)
        column, row = whole.indices(x[:50], y[:50])
        part_column, part_row = part.indices(x[:50], y[:50])
        assert (column + whole.west == part_column + part.west).all()
        assert (row + whole.south == part_row + part.south).all()

    def test_no_points_give_an_empty_grid(self):
        grid = Grid.around([], [], 0.5)
        assert grid.shape == (0, 0)
        assert lowest_per_cell(grid, [], [], []).shape == (0, 0)
        assert fill_gaps(np.empty((0, 0))).shape == (0, 0)

    def test_one_point_gives_one_cell(self):
        assert Grid.around([0.3], [-0.3], 0.5) == Grid(0, -1, 1, 1, 0.5)


def literal_per_cell(grid, x, y, z, reduce):
    cells = {}
    for a, b, c in zip(x, y, z, strict=True):
        key = int(np.floor(b / grid.cell_size_m)), int(np.floor(a / grid.cell_size_m))
        cells.setdefault(key, []).append(c)
    out = np.full(grid.shape, np.nan)
    for (row, column), values in cells.items():
        out[row - grid.south, column - grid.west] = reduce(values)
    return out


@pytest.mark.parametrize(("function", "reduce"), [(lowest_per_cell, min)])
def test_per_cell_statistics_equal_a_literal_loop(rng, function, reduce):
    x, y, z = rng.uniform(-4, 4, 300), rng.uniform(2, 9, 300), rng.normal(size=300)
    grid = Grid.around(x, y, 0.8)
    found = function(grid, x, y, z)
    assert np.isnan(found).any()
    np.testing.assert_allclose(found, literal_per_cell(grid, x, y, z, reduce), rtol=1e-12)


class TestFillGaps:
    def test_each_gap_takes_the_nearest_known_value(self, rng):
        values = rng.normal(size=(12, 9))
        values[rng.random(values.shape) < 0.7] = np.nan
        filled = fill_gaps(values)
        known = np.argwhere(np.isfinite(values))
        for cell in np.argwhere(np.isnan(values)):
            distance = np.hypot(*(known - cell).T)
            nearest = {values[tuple(k)] for k in known[distance <= distance.min() + 1e-9]}
            assert filled[tuple(cell)] in nearest
        assert (filled[np.isfinite(values)] == values[np.isfinite(values)]).all()

    def test_without_any_known_value_nothing_is_invented(self):
        assert np.isnan(fill_gaps(np.full((2, 3), np.nan))).all()

    def test_a_full_array_stays_as_it_is(self, rng):
        values = rng.normal(size=(3, 4))
        assert (fill_gaps(values) == values).all()


class TestBilinear:
    def test_a_plane_is_reproduced_between_the_outer_centres(self, rng):
        grid = Grid.over(-3, 2, 5, 9, 0.5)
        x, y = grid.centres(*np.meshgrid(np.arange(grid.columns), np.arange(grid.rows)))
        values = 2 * x - 3 * y + 1
        px, py = rng.uniform(-2.7, 5.2, 200), rng.uniform(2.3, 9.2, 200)
        found = sample_bilinear(grid, values, px, py)
        np.testing.assert_allclose(found, 2 * px - 3 * py + 1, atol=1e-9)

    def test_outside_the_border_value_goes_on(self):
        grid = Grid.over(0, 0, 1, 0, 1.0)
        found = sample_bilinear(grid, np.array([[5.0, 7.0]]), [-50, 0.5, 1.0, 50], [9, 0, 0.5, 0.5])
        np.testing.assert_allclose(found, [5, 5, 6, 7])
