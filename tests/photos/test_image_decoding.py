import io
import struct
import sys

import numpy as np
import pytest
import torch
from PIL import Image, ImageCms, features

from instok3d.photos import image_decoding
from instok3d.photos.image_decoding import decode_photo, own_pixel_limit

TO_STORED = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}
needs_avif = pytest.mark.skipif(not features.check("avif"), reason="Pillow was built without AVIF")
LEVELS = torch.tensor([[0.0, 0.2, 0.4], [0.6, 0.8, 1.0]])
"""Six grey fields, all different, so that every turn and mirroring shows."""


def fields(mode: str) -> Image.Image:
    """48 x 72 pixels of the six fields, in a Pillow mode."""
    levels = LEVELS.repeat_interleave(24, 0).repeat_interleave(24, 1).numpy()
    if mode == "I;16":
        return Image.fromarray(np.round(levels * 65535).astype(np.uint16))
    grey = Image.fromarray(np.round(levels * 255).astype(np.uint8))
    if mode == "1":
        return Image.fromarray(levels > 0.5)
    return grey.convert("RGB").convert(mode) if mode == "CMYK" else grey.convert(mode)


def save_turned(image: Image.Image, orientation: int, path) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    if orientation in TO_STORED:
        image = image.transpose(TO_STORED[orientation])
    image.save(path, exif=exif, quality=95)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize(
    ("mode", "suffix"),
    [
        ("L", "png"),
        ("LA", "png"),
        ("P", "png"),
        ("RGB", "png"),
        ("RGBA", "png"),
        ("I;16", "png"),
        ("RGB", "jpg"),
        ("L", "jpg"),
        ("CMYK", "jpg"),
        ("1", "png"),
        ("RGB", "webp"),
        pytest.param("RGB", "avif", marks=needs_avif),
        ("RGB", "tif"),
        ("CMYK", "tif"),
        ("I;16", "tif"),
    ],
)
def test_every_orientation_of_every_mode_stands_upright(tmp_path, mode, suffix, orientation):
    path = tmp_path / f"photo.{suffix}"
    save_turned(fields(mode), orientation, path)
    photo = decode_photo(path, height=20, width=30)
    expected = LEVELS.round() if mode == "1" else LEVELS
    assert (photo.image[:, 5::10, 5::10] - expected).abs().max() < 0.02
    assert photo.pixel_map.original_height == 48
    assert photo.pixel_map.original_width == 72
    assert photo.notes == ()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_pixel_map_of_a_cropped_turned_photo_finds_a_mark(tmp_path, orientation):
    # One white block of the upright photo, off centre; its centre is at (50, 30).
    pixels = np.zeros((90, 120), np.uint8)
    pixels[24:36, 44:56] = 255
    path = tmp_path / "photo.png"
    save_turned(Image.fromarray(pixels), orientation, path)
    photo = decode_photo(path, height=45, width=45)
    weights = photo.image[0].double()
    axis = torch.arange(45) + 0.5
    x, y = (weights.sum(0) @ axis.double()), (weights.sum(1) @ axis.double())
    found = torch.stack([x, y]) / weights.sum()
    expected = photo.pixel_map.to_model(torch.tensor([50.0, 30.0]).double())
    assert (found - expected).abs().max() < 0.05
    assert photo.pixel_map.exif_orientation == orientation


def test_sixteen_bit_grey_keeps_its_range_and_its_steps(tmp_path):
    values = np.array([[0, 257], [32768, 65535]], np.uint16).repeat(8, 0).repeat(8, 1)
    Image.fromarray(values).save(tmp_path / "grey.png")
    # The filter reaches into the neighbours: compare far from the borders between fields.
    image = decode_photo(tmp_path / "grey.png", height=16, width=16).image
    expected = torch.tensor([[0.0, 257 / 65535], [32768 / 65535, 1.0]])
    torch.testing.assert_close(image[0, 3::8, 3::8], expected)


def test_transparent_pixels_lie_on_white_and_do_not_bleed(tmp_path):
    # Fully transparent black beside opaque red: white and red, and no dark seam between them.
    pixels = np.zeros((16, 16, 4), np.uint8)
    pixels[:, 8:] = (255, 0, 0, 255)
    Image.fromarray(pixels).save(tmp_path / "alpha.png")
    image = decode_photo(tmp_path / "alpha.png", height=8, width=8).image
    torch.testing.assert_close(image[:, 4, 0], torch.ones(3))
    torch.testing.assert_close(image[:, 4, 7], torch.tensor([1.0, 0.0, 0.0]))
    assert image[0].min() > 0.99


def test_palette_with_a_transparent_entry_lies_on_white(tmp_path):
    image = Image.new("P", (8, 8), 1)
    image.putpalette([0, 0, 0, 0, 0, 255])
    image.putpixel((0, 0), 0)
    image.save(tmp_path / "p.png", transparency=0)
    pixels = decode_photo(tmp_path / "p.png", height=8, width=8).image
    torch.testing.assert_close(pixels[:, 0, 0], torch.ones(3))
    torch.testing.assert_close(pixels[:, 4, 4], torch.tensor([0.0, 0.0, 1.0]))


def test_letterbox_keeps_all_of_the_photo_between_grey_bars(tmp_path):
    Image.new("RGB", (40, 20), "white").save(tmp_path / "wide.png")
    image = decode_photo(tmp_path / "wide.png", height=20, width=20, fit="letterbox").image
    assert (image[:, 5:15] == 1).all()
    assert (image[:, :5] == 0.5).all()
    assert (image[:, 15:] == 0.5).all()


@pytest.mark.parametrize("size", [(1600, 1200), (1603, 1201), (1205, 1609)])
def test_jpeg_decoded_at_a_fraction_is_the_same_picture(tmp_path, size, monkeypatch):
    x, y = np.meshgrid(np.linspace(0, 9, size[0]), np.linspace(0, 7, size[1]))
    pixels = np.stack([np.sin(x + y), np.cos(x), np.sin(y)], -1) * 120 + 128
    path = tmp_path / "large.jpg"
    Image.fromarray(pixels.astype(np.uint8)).save(path, quality=95, exif=_orientation(6))
    fast = decode_photo(path, height=48, width=64).image
    monkeypatch.setattr("PIL.JpegImagePlugin.JpegImageFile.draft", lambda *_: None)
    slow = decode_photo(path, height=48, width=64).image
    assert (fast - slow).abs().max() < 2.5 / 255


def test_of_an_animation_the_first_picture_is_taken_and_it_says_so(tmp_path):
    first, second = Image.new("RGB", (9, 9), "white"), Image.new("RGB", (9, 9), "black")
    first.save(tmp_path / "moving.gif", save_all=True, append_images=[second])
    photo = decode_photo(tmp_path / "moving.gif", height=4, width=4)
    assert photo.image.min() > 0.99
    assert "only the first one is used" in photo.notes[0]


def _orientation(value: int) -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112] = value
    return exif


def _focal_exif(focal_35mm: int, width: int, height: int) -> Image.Exif:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0xA405: focal_35mm, 0xA002: width, 0xA003: height})
    return exif


def test_focal_length_of_exif_by_hand(tmp_path):
    # 400 x 300 has a diagonal of 500 pixels; 36 x 24 mm one of 43.267 mm: 26 x 500 / 43.267.
    Image.new("RGB", (400, 300)).save(tmp_path / "a.jpg", exif=_focal_exif(26, 4000, 3000))
    assert decode_photo(tmp_path / "a.jpg", height=8, width=8).focal == pytest.approx(300.463, 1e-5)


def test_focal_length_of_a_photo_that_was_cropped_later_is_not_trusted(tmp_path):
    Image.new("RGB", (300, 300)).save(tmp_path / "a.jpg", exif=_focal_exif(26, 4000, 3000))
    assert decode_photo(tmp_path / "a.jpg", height=8, width=8).focal is None


def test_unknown_orientation_is_told(tmp_path):
    Image.new("RGB", (30, 20)).save(tmp_path / "a.png", exif=_orientation(9))
    photo = decode_photo(tmp_path / "a.png", height=8, width=8)
    assert photo.pixel_map.original_width == 30
    assert "unknown EXIF orientation 9" in photo.notes[0]


def _profile_with_red_and_blue_exchanged() -> bytes:
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    head, body = profile[:600], profile[600:]
    return head.replace(b"rXYZ", b"????").replace(b"bXYZ", b"rXYZ").replace(b"????", b"bXYZ") + body


def test_a_colour_profile_is_followed(tmp_path):
    # In a profile whose first primary is sRGB's blue, (255, 0, 0) is pure blue.
    image = Image.new("RGB", (8, 8), (255, 0, 0))
    image.save(tmp_path / "a.png", icc_profile=_profile_with_red_and_blue_exchanged())
    pixel = decode_photo(tmp_path / "a.png", height=4, width=4).image[:, 2, 2]
    assert (pixel - torch.tensor([0.0, 0.0, 1.0])).abs().max() < 0.02


def test_a_broken_colour_profile_is_told(tmp_path):
    broken = b"\0" * 16 + b"RGB " + b"\0" * 200
    Image.new("RGB", (8, 8), (255, 0, 0)).save(tmp_path / "a.png", icc_profile=broken)
    photo = decode_photo(tmp_path / "a.png", height=4, width=4)
    torch.testing.assert_close(photo.image[:, 2, 2], torch.tensor([1.0, 0.0, 0.0]))
    assert "colour profile of a.png is broken" in photo.notes[0]


def test_sha256_is_of_the_file(tmp_path):
    (tmp_path / "a.ppm").write_bytes(b"P6 1 1 255\n\x00\x00\x00")
    # sha256sum of these 14 bytes.
    photo = decode_photo(tmp_path / "a.ppm", height=2, width=2)
    expected = "29ed444ca1f60c900547fc9b077bdd96e6d2d3729734f115f02e3631c374341d"
    assert photo.sha256 == expected


def _noise_jpeg() -> bytes:
    stream = io.BytesIO()
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(noise).save(stream, "jpeg")
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("cut.jpg", _noise_jpeg()[:2000], r"cut\.jpg is damaged or cut off .* copy it again"),
        ("text.png", b"just a few words", r"text\.png is not a picture in a known format"),
        ("empty.jpg", b"", r"empty\.jpg is empty \(0 bytes\)"),
        ("film.jpg", b"\0\0\0\x20ftypisom\0\0\2\0isomiso2avc1mp41", "not a picture in a known"),
        ("page.png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "not a picture"),
        ("head.png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "not a picture|damaged|broken header"),
    ],
)
def test_a_bad_file_is_named_and_what_to_do(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=message):
        decode_photo(tmp_path / name, height=8, width=8)


@pytest.mark.parametrize("suffix", ["png", "jpg", "webp", "tif", "gif", "bmp"])
@pytest.mark.parametrize("tenths", range(1, 10, 2))
def test_a_file_cut_anywhere_is_a_value_error(tmp_path, suffix, tenths):
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    path = tmp_path / f"cut.{suffix}"
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * tenths // 10])
    with pytest.raises(ValueError, match=rf"cut\.{suffix}"):
        decode_photo(path, height=8, width=8)


def _png_that_claims(width: int, height: int) -> bytes:
    """A few bytes whose header promises that many pixels."""
    import zlib

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 99))
    return b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")


@pytest.mark.parametrize("side", [10_000, 30_000])
def test_a_decompression_bomb_is_refused_from_its_header(tmp_path, side, monkeypatch):
    (tmp_path / "bomb.png").write_bytes(_png_that_claims(side, side))
    monkeypatch.setattr(image_decoding, "_resample", lambda *_: pytest.fail("was decoded"))
    message = rf"bomb\.png has {side} x {side} = {side * side / 1e6:.1f} megapixels, more than"
    with own_pixel_limit(), pytest.raises(ValueError, match=message + ".* make it smaller"):
        decode_photo(tmp_path / "bomb.png", height=8, width=8)
    assert Image.MAX_IMAGE_PIXELS is not None


def test_a_bomb_is_refused_under_the_limit_of_pillow_too(tmp_path):
    (tmp_path / "bomb.png").write_bytes(_png_that_claims(30_000, 30_000))
    with pytest.raises(ValueError, match=r"bomb\.png is too large"):
        decode_photo(tmp_path / "bomb.png", height=8, width=8)


def test_a_file_of_more_bytes_than_pixels_allow_is_not_read(tmp_path):
    (tmp_path / "long.png").write_bytes(b"\0" * (2**20 + 9000))
    with pytest.raises(ValueError, match=r"long\.png has 1 MB, more than 0\.001 megapixels"):
        decode_photo(tmp_path / "long.png", height=8, width=8, max_pixels=1000)


def test_a_missing_and_a_forbidden_file_are_named(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match=r"there is no file .*none\.jpg"):
        decode_photo(tmp_path / "none.jpg", height=8, width=8)
    (tmp_path / "secret.jpg").write_bytes(b"x")

    def refuse(_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.read_bytes", refuse)
    with pytest.raises(PermissionError, match=r"secret\.jpg may not be read"):
        decode_photo(tmp_path / "secret.jpg", height=8, width=8)


def test_heic_without_the_plugin_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic")
    with pytest.raises(ValueError, match=r"a\.heic .* pip install 'instok3d\[heic\]'"):
        decode_photo(tmp_path / "a.heic", height=8, width=8)


@pytest.mark.parametrize("orientation", [1, 6])
def test_heic_with_the_plugin_is_read_upright(tmp_path, orientation):
    plugin = pytest.importorskip("pillow_heif")
    plugin.register_heif_opener()
    path = tmp_path / "a.heic"
    stored = fields("RGB")
    if orientation in TO_STORED:
        stored = stored.transpose(TO_STORED[orientation])
    stored.save(path, exif=_orientation(orientation).tobytes())
    image = decode_photo(path, height=20, width=30).image
    assert (image[:, 5::10, 5::10] - LEVELS).abs().max() < 0.05
