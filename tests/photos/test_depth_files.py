import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.photos.depth_files import depth_at_model_pixels, read_depth
from instok3d.photos.pixel_map import fit_pixels
from mutations import limits, of_bytes, survive

TRANSPOSE = {1: None, 3: Image.Transpose.ROTATE_180, 6: Image.Transpose.ROTATE_270,
             8: Image.Transpose.ROTATE_90}  # fmt: skip


def test_sixteen_bit_depth_by_hand(tmp_path):
    # 1500 / 1000 = 1.5; 0 and 65535 are both "no depth".
    Image.fromarray(np.array([[1500, 0], [65535, 40000]], np.uint16)).save(tmp_path / "d.png")
    depth = read_depth(tmp_path / "d.png", scale=1000.0)
    torch.testing.assert_close(depth, torch.tensor([[1.5, 0.0], [0.0, 40.0]]))


@pytest.mark.parametrize("suffix", ["npy", "tif"])
def test_float_depth_loses_what_is_not_finite_or_negative(tmp_path, suffix):
    values = np.array([[1.25, np.nan], [np.inf, -2.0]], np.float32)
    path = tmp_path / f"d.{suffix}"
    np.save(path, values) if suffix == "npy" else Image.fromarray(values).save(path)
    torch.testing.assert_close(read_depth(path, scale=1.0), torch.tensor([[1.25, 0], [0, 0]]))


def test_cropped_depth_by_hand():
    # 4 x 8 into 2 x 2: scale 1/2, two columns cut on each side. The centres of the model's pixels
    # lie at (3, 1), (5, 1), (3, 3), (5, 3): floor gives the columns 3, 5 and rows 1, 3.
    depth = torch.arange(32.0).view(4, 8)
    pixel_map = fit_pixels(4, 8, 2, 2)
    expected = torch.tensor([[11.0, 13.0], [27.0, 29.0]])
    assert torch.equal(depth_at_model_pixels(depth, pixel_map), expected)


def test_no_depth_lies_between_two_surfaces_and_holes_stay_holes():
    depth = torch.ones(480, 640)
    depth[:, 320:] = 5.0
    depth[100:200] = 0.0
    fitted = depth_at_model_pixels(depth, fit_pixels(480, 640, 37, 53))
    assert set(fitted.unique().tolist()) == {0.0, 1.0, 5.0}


def test_depth_of_a_smaller_sensor_covers_the_same_view():
    depth = torch.zeros(24, 32)
    depth[:, 16:] = 2.0
    fitted = depth_at_model_pixels(depth, fit_pixels(480, 640, 48, 64))
    assert (fitted[:, :32] == 0).all()
    assert (fitted[:, 32:] == 2).all()


def test_letterbox_bars_have_no_depth():
    fitted = depth_at_model_pixels(torch.ones(4, 8), fit_pixels(4, 8, 8, 8, fit="letterbox"))
    assert fitted.sum(dim=1).tolist() == [0, 0, 8, 8, 8, 8, 0, 0]


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_depth_turns_with_its_photo(orientation):
    stored = np.arange(1, 13, dtype=np.uint8).reshape(3, 4)
    image = Image.fromarray(stored)
    turn = TRANSPOSE[orientation]
    upright = np.asarray(image if turn is None else image.transpose(turn))
    pixel_map = fit_pixels(*upright.shape, *upright.shape, exif_orientation=orientation)
    found = depth_at_model_pixels(
        torch.from_numpy(stored).float(), pixel_map, stored_orientation=orientation
    )
    assert np.array_equal(found.numpy(), upright)


def test_bad_depth_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no depth file .*none\.png"):
        read_depth(tmp_path / "none.png", scale=1.0)
    (tmp_path / "text.png").write_text("depth")
    with pytest.raises(ValueError, match=r"text\.png is not a depth picture"):
        read_depth(tmp_path / "text.png", scale=1.0)
    Image.new("RGB", (4, 4)).save(tmp_path / "color.png")
    with pytest.raises(ValueError, match=r"color\.png has RGB pixels, wanted one"):
        read_depth(tmp_path / "color.png", scale=1.0)
    np.save(tmp_path / "three.npy", np.zeros((2, 2, 3)))
    with pytest.raises(ValueError, match=r"three\.npy holds float64 of shape \(2, 2, 3\)"):
        read_depth(tmp_path / "three.npy", scale=1.0)
    np.save(tmp_path / "objects.npy", np.array([[{}]]), allow_pickle=True)
    with pytest.raises(ValueError, match=r"objects\.npy is not a \.npy array of numbers"):
        read_depth(tmp_path / "objects.npy", scale=1.0)
    Image.fromarray(np.ones((64, 64), np.uint16)).save(tmp_path / "big.png")
    with pytest.raises(ValueError, match=r"big\.png has 0\.0 megapixels, more than"):
        read_depth(tmp_path / "big.png", scale=1.0, max_pixels=1000)
    noise = np.random.default_rng(0).integers(0, 9999, (64, 64)).astype(np.uint16)
    Image.fromarray(noise).save(tmp_path / "cut.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "cut.png").read_bytes()[:2000])
    with pytest.raises(ValueError, match=r"cut\.png is damaged"):
        read_depth(tmp_path / "cut.png", scale=1.0)


def slope(width: int = 40) -> np.ndarray:
    """Millimetres of a wall that is seen at an angle, with holes."""
    row = np.linspace(1000, 3000, width).astype(np.uint16)
    values = np.stack([row + 7 * k for k in range(30)])
    values[3:6, 5:9] = 0
    return values


@pytest.mark.parametrize("suffix", ["png", "pgm", "tif", "npy"])
def test_byte_swapped_depth_is_refused_in_every_format(tmp_path, suffix):
    path = tmp_path / f"d.{suffix}"
    for values, is_right in ((slope(), True), (slope().byteswap(), False)):
        np.save(path, values) if suffix == "npy" else Image.fromarray(values).save(path)
        if is_right:
            assert float(read_depth(path, scale=1000.0).max()) == pytest.approx(3.2, abs=0.01)
        else:
            with pytest.raises(ValueError, match=rf"d\.{suffix} looks byte-swapped"):
                read_depth(path, scale=1000.0)


def test_arrays_in_either_byte_order_are_read_by_their_header(tmp_path):
    for order in ("<u2", ">u2"):
        np.save(tmp_path / "d.npy", slope().astype(order))
        assert float(read_depth(tmp_path / "d.npy", scale=1000.0).max()) < 4


@pytest.mark.parametrize(
    "values",
    [
        np.zeros((0, 4), np.uint16),
        np.zeros((4, 4), np.uint16),
        np.full((4, 4), 2000, np.uint16),
        np.full((4, 1), 2000, np.uint16),
        256 * (slope() // 256),
        np.random.default_rng(0).integers(0, 9999, (64, 64)).astype(np.uint16),
        70_000 + slope().astype(np.int32),
        slope().astype(np.int64) - 2000,
    ],
)
def test_other_numbers_are_not_taken_for_byte_swapped(tmp_path, values):
    np.save(tmp_path / "d.npy", values)
    assert read_depth(tmp_path / "d.npy", scale=1.0).shape == values.shape


@pytest.mark.parametrize("value", [1e10, 1e300, -1e300, np.inf, np.nan])
def test_what_is_endlessly_far_is_unknown(tmp_path, value):
    np.save(tmp_path / "d.npy", np.array([[2.0, value]]))
    assert read_depth(tmp_path / "d.npy", scale=1.0).tolist() == [[2.0, 0.0]]


def test_large_arrays_are_refused_too(tmp_path):
    np.save(tmp_path / "d.npy", np.ones((64, 64)))
    with pytest.raises(ValueError, match=r"d\.npy has 0\.0 megapixels, more than"):
        read_depth(tmp_path / "d.npy", scale=1.0, max_pixels=1000)


def test_a_damaged_array_is_read_or_refused_in_one_line(tmp_path):
    path = tmp_path / "d.npy"
    np.save(path, np.ones((8, 6)))
    assert survive(path, lambda: read_depth(path, scale=1.0), of_bytes, 120)


def test_an_array_shorter_or_longer_than_its_header_says_is_refused(tmp_path):
    path = tmp_path / "d.npy"
    np.save(path, np.ones((8, 6)))
    whole = path.read_bytes()
    for data in (whole[:-8], whole + bytes(8)):
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r"d\.npy is not a .* promises 384 bytes, \d+ are"):
            read_depth(path, scale=1.0)


def test_an_array_too_large_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "d.npy"
    with path.open("wb") as stream:
        stream.truncate(2**40)  # takes no place on the disk
    with pytest.raises(ValueError, match=r"d\.npy has 1099511627776 bytes, more than 64 megapix"):
        read_depth(path, scale=1.0)


@pytest.mark.parametrize("ending", ["png", "tiff", "pgm", "npy"])
def test_any_damage_of_a_depth_picture_is_refused_or_read(tmp_path, ending):
    file = tmp_path / f"depth.{ending}"
    values = np.random.default_rng(0).integers(500, 6000, (6, 8)).astype(np.uint16)
    if ending == "npy":
        np.save(file, values)
    else:
        Image.fromarray(values.astype(np.float32) if ending == "tiff" else values).save(file)

    def read() -> None:
        depth = read_depth(file, scale=1000.0)
        assert depth.isfinite().all()
        assert (depth >= 0).all()

    assert survive(file, read, of_bytes, 600)


def test_a_png_whose_chunk_promises_four_gigabytes_takes_no_memory(tmp_path):
    file = tmp_path / "depth.png"
    Image.fromarray(np.full((6, 8), 1000, np.uint16)).save(file)
    data = bytearray(file.read_bytes())
    at = data.index(b"IDAT") - 4
    data[at : at + 4] = (2**32 - 1).to_bytes(4, "big")
    file.write_bytes(data)
    with limits():
        assert torch.equal(read_depth(file, scale=1000.0), torch.ones(6, 8))  # all of it is there
