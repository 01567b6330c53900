import json

import numpy as np
import pytest

from instok3d.evaluation.outlines import (
    FORMAT,
    OutlinedObject,
    PhotoOutlines,
    filled,
    read_outlines,
    read_photo_outlines,
)

SQUARE = [[1, 1], [4, 1], [4, 3], [1, 3]]


def outlines(*objects: OutlinedObject, height: int = 4, width: int = 6) -> PhotoOutlines:
    return PhotoOutlines("a.jpg", "0" * 64, height, width, objects)


def thing(*polygons: list, holes: tuple[list, ...] = ()) -> OutlinedObject:
    def rings(value) -> tuple[np.ndarray, ...]:
        return tuple(np.array(ring, dtype=np.float64) for ring in value)

    return OutlinedObject("thing", False, rings(polygons), rings(holes))


def written(folder, **changes):
    value = {
        "format": FORMAT, "photo": "a.jpg", "sha256": "ab" * 32, "height": 4, "width": 6,
        "objects": [{"name": "mug", "stuff": False, "polygons": [SQUARE]}], **changes,
    }  # fmt: skip
    path = folder / f"{value['sha256'][:4]}.json"
    path.write_text(json.dumps(value))
    return path


def test_pixels_whose_centres_lie_in_a_polygon_are_filled():
    # Columns 1 to 3 and rows 1 to 2 have their centres in x 1..4, y 1..3.
    expected = np.zeros((4, 6), bool)
    expected[1:3, 1:4] = True
    np.testing.assert_array_equal(filled(np.array(SQUARE, float), 4, 6), expected)
    backwards = np.array(SQUARE[::-1], float)
    np.testing.assert_array_equal(filled(backwards, 4, 6), expected)


def test_a_triangle_by_hand():
    # Below the diagonal from (0, 0) to (4, 4): row r has the centres c + 0.5 <= r + 0.5; a centre
    # on a right edge is outside, so c < r.
    ring = np.array([[0, 0], [4, 4], [0, 4]], float)
    np.testing.assert_array_equal(filled(ring, 4, 4), np.tril(np.ones((4, 4), bool), -1))


def test_polygons_that_share_an_edge_share_no_pixel_and_leave_none_out():
    rng = np.random.default_rng(0)
    for _ in range(20):
        top, bottom = rng.uniform(0, 9, 2).round(1)  # .5 often: through the centres
        left = np.array([[0, 0], [top, 0], [bottom, 9], [0, 9]])
        right = np.array([[top, 0], [9, 0], [9, 9], [bottom, 9]])
        count = filled(left, 9, 9).astype(int) + filled(right, 9, 9)
        np.testing.assert_array_equal(count, 1)


def test_what_leaves_the_picture_is_cut_off():
    ring = np.array([[-50, -50], [3, -50], [3, 50], [-50, 50]], float)
    expected = np.zeros((4, 6), bool)
    expected[:, :3] = True
    np.testing.assert_array_equal(filled(ring, 4, 6), expected)
    assert not filled(ring + 100, 4, 6).any()
    assert not filled(ring - 100, 4, 6).any()


def test_holes_are_no_part_of_an_object_and_parts_that_overlap_are():
    mask = thing([[0, 0], [6, 0], [6, 4], [0, 4]], holes=(SQUARE,)).mask(4, 6)
    np.testing.assert_array_equal(mask, ~filled(np.array(SQUARE, float), 4, 6))
    twice = thing(SQUARE, SQUARE).mask(4, 6)
    assert twice.sum() == 6


def test_a_later_object_covers_an_earlier_one():
    ids = outlines(thing([[0, 0], [3, 0], [3, 4], [0, 4]]), thing(SQUARE)).id_map()
    np.testing.assert_array_equal(
        ids, [[1, 1, 1, 0, 0, 0], [1, 2, 2, 2, 0, 0], [1, 2, 2, 2, 0, 0], [1, 1, 1, 0, 0, 0]]
    )


def test_a_photo_without_objects_has_no_id():
    assert not outlines().id_map().any()


def test_a_file_is_read_as_it_was_written(tmp_path):
    read = read_photo_outlines(written(tmp_path))
    assert (read.photo, read.sha256, read.height, read.width) == ("a.jpg", "ab" * 32, 4, 6)
    (mug,) = read.objects
    assert (mug.name, mug.stuff, mug.holes) == ("mug", False, ())
    np.testing.assert_array_equal(mug.polygons[0], SQUARE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "instok3d-outlines-2"}, "'instok3d-outlines-2' is none of"),
        ({"sha256": "abc"}, "'abc' is none of 64 hexadecimal digits"),
        ({"height": 0}, "0 is no whole number from 1"),
        ({"objects": {}}, "the objects are no list"),
        ({"objects": [{"name": "mug"}]}, "it lacks 'polygons'"),
        ({"objects": [{"name": "mug", "polygons": []}]}, "'mug' has no polygon"),
        ({"objects": [{"name": "mug", "polygons": [SQUARE[:2]]}]}, "3 or more vertices"),
        ({"objects": [{"name": "mug", "polygons": SQUARE}]}, "polygons of 'mug' are no list"),
        ({"objects": [{"name": "mug", "polygons": [[*SQUARE, [1, 1e9]]]}]}, "leave the picture"),
        ({"objects": [{"name": "m", "polygons": [SQUARE], "stuff": "no"}]}, "none of True, False"),
    ],
)
def test_a_damaged_file_is_named_with_the_reason(tmp_path, changes, message):
    path = written(tmp_path, **changes)
    with pytest.raises(ValueError, match=r"docs/formats.md") as error:
        read_photo_outlines(path)
    assert str(path) in str(error.value)
    assert message in str(error.value)


def test_two_outlines_of_one_photo_are_refused_with_both_names(tmp_path):
    written(tmp_path).rename(tmp_path / "one.json")
    written(tmp_path).rename(tmp_path / "two.json")
    with pytest.raises(ValueError, match=r"one\.json and .*two\.json outline the same photo"):
        read_outlines(tmp_path)


def test_a_folder_without_outlines_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no outlines"):
        read_outlines(tmp_path)
    with pytest.raises(FileNotFoundError, match="no folder of outlines"):
        read_outlines(tmp_path / "nowhere")


def test_outlines_of_the_package_name_twelve_photos_and_leave_no_object_hidden():
    found = read_outlines()
    assert len(found) == 12
    for each in found.values():
        ids = each.id_map()
        assert set(np.unique(ids)) >= set(range(1, len(each.objects) + 1)), each.photo
        assert (ids > 0).mean() > 0.9


def test_outlines_of_the_package_belong_to_the_photos_that_they_name(shared):
    from instok3d.files import sha256_of

    folder = shared / "data" / "rgbd_posed"
    if not folder.is_dir():
        pytest.skip(f"the captures are not here: no folder {folder}")
    for each in read_outlines().values():
        assert sha256_of(folder / each.photo) == each.sha256
