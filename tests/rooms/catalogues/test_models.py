"""Models of a catalogue as furniture of the rooms."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex")

from glb_files import block, square, table, write_furniture
from instok3d.rooms.catalogues import models
from instok3d.rooms.catalogues.model_classes import GENERATOR_OF_FILE, GENERATOR_OF_NAME, class_of
from instok3d.rooms.catalogues.models import FurnitureCatalogue, load_model
from instok3d.rooms.classes import CLASSES
from instok3d.rooms.materials import Maker
from instok3d.rooms.objects import REGISTRY
from mutations import of_json, survive


def test_every_generator_of_the_table_exists_and_makes_the_class_that_the_table_says():
    for generator in {*GENERATOR_OF_NAME.values(), *GENERATOR_OF_FILE.values()} - {""}:
        made = REGISTRY[generator](Maker(np.random.default_rng(0)))
        assert made.name == class_of(generator)
        assert made.name in CLASSES


def test_a_model_stands_on_the_floor_its_front_to_minus_y(tmp_path):
    # 1 m wide, 0.5 high, 0.2 deep; a knob at the front, which in the file is +z.
    body = block((-0.5, 0.3, -0.1), (0.5, 0.8, 0.1), factor=(0, 0, 1, 1))
    knob = block((-0.02, 0.5, 0.1), (0.02, 0.54, 0.14))
    folder = write_furniture(tmp_path, {"Chair": [body, knob]})
    chair = load_model(folder / "Chair.glb", "chair")
    assert chair.size == pytest.approx((1.0, 0.24, 0.5), abs=1e-6)
    assert (chair.name, chair.source, chair.supports) == ("chair", "model:Chair", ())
    assert min(part.vertices[:, 2].min() for part in chair.parts) == pytest.approx(0, abs=1e-6)
    assert chair.parts[1].vertices[:, 1].mean() < chair.parts[0].vertices[:, 1].mean()


def test_normals_point_outwards_and_are_unit(tmp_path):
    folder = write_furniture(tmp_path, {"Chair": [block((-1, 0, -1), (1, 2, 1))]})
    (part,) = load_model(folder / "Chair.glb", "chair").parts
    outwards = part.vertices - [0, 0, 1]
    assert ((part.normals * outwards).sum(1) > 0.9).all()
    np.testing.assert_allclose(np.linalg.norm(part.normals, axis=1), 1)


def test_a_linear_factor_becomes_the_colour_that_the_renderer_decodes(tmp_path):
    folder = write_furniture(tmp_path, {"Table": table()})
    top = load_model(folder / "Table.glb", "table").parts[0]
    # 255 * 0.5^(1 / 2.2) = 186.1
    assert top.material.texture[0, 0].tolist() == [186, 0, 0]


def test_a_picture_is_upright_and_its_tile_is_its_size_on_the_surface(tmp_path):
    rows = np.zeros((8, 8, 3), np.uint8)
    rows[0] = 200  # the top row is bright
    folder = write_furniture(tmp_path, {"Table": square(rows, side=2.0)})
    (part,) = load_model(folder / "Table.glb", "table").parts
    assert part.material.texture[0, 0].tolist() == [200, 200, 200]
    assert part.material.tile_m == pytest.approx(2.0)
    top = part.vertices[:, 2] > 1
    # Texture v runs upwards in the rooms, so the top of the square is at one whole tile.
    np.testing.assert_allclose(part.uvs[top, 1] / part.material.tile_m, 1, atol=1e-6)
    np.testing.assert_allclose(part.uvs[~top, 1], 0, atol=1e-6)


@pytest.mark.parametrize("shift", [7.0, -3.4e9, 3.4e38])
def test_coordinates_far_outside_a_picture_stay_within_what_the_renderer_counts(tmp_path, shift):
    model = square(np.full((8, 8, 3), 99, np.uint8))
    shifted = [{**model[0], "uvs": model[0]["uvs"] + shift}]
    folder = write_furniture(tmp_path, {"Table": model, "Desk": shifted})
    (part,) = load_model(folder / "Desk.glb", "desk").parts
    tiles = part.uvs / part.material.tile_m
    assert np.abs(tiles).max() <= 1000
    if shift == 7:
        (same,) = load_model(folder / "Table.glb", "table").parts
        np.testing.assert_allclose(tiles, same.uvs, atol=1e-5)


def test_what_hangs_on_a_wall_has_its_origin_in_the_middle_of_its_back(tmp_path):
    cabinet = block((-0.3, 1.4, -0.2), (0.3, 2.0, 0.2))
    folder = write_furniture(tmp_path, {"Upper cabinet": [cabinet]}, elevation_m=1.4)
    catalogue, rng = FurnitureCatalogue.open(folder), np.random.default_rng(0)
    model = next(m for _ in range(99) if (m := catalogue.draw(rng, "wall_cabinet")) is not None)
    corners = np.concatenate([part.vertices for part in model.parts])
    np.testing.assert_allclose(corners.min(0), [-0.3, -0.4, -0.3], atol=1e-6)
    np.testing.assert_allclose(corners.max(0), [0.3, 0.0, 0.3], atol=1e-6)
    assert (model.name, model.supports) == ("cabinet", ())


def test_small_things_stand_on_a_model_and_not_on_one_that_hangs(tmp_path):
    folder = write_furniture(tmp_path, {"Table": table()})
    (support,) = load_model(folder / "Table.glb", "table").supports
    assert support.z == pytest.approx(0.75, abs=1e-3)
    hanging = load_model(folder / "Table.glb", "table", 0.4)
    assert hanging.supports == ()
    assert hanging.size[2] == pytest.approx(1.15, abs=1e-6)
    assert min(part.vertices[:, 2].min() for part in hanging.parts) == pytest.approx(0.4, abs=1e-6)


def test_models_are_drawn_only_for_their_generator_and_not_always(tmp_path):
    names = {"Chair": table(0.4, 0.4, 0.5), "Desk": table(), "Plastic chair": table(0.5, 0.5, 0.5)}
    catalogue = FurnitureCatalogue.open(write_furniture(tmp_path, names))
    rng = np.random.default_rng(0)
    drawn = [catalogue.draw(rng, "chair") for _ in range(300)]
    sources = [model.source for model in drawn if model is not None]
    assert set(sources) == {"model:Chair", "model:Plastic chair"}
    # Half of the time, times 2 / (2 + 2) for a class of two models: 75 of 300.
    assert 50 < len(sources) < 100
    assert all(catalogue.draw(rng, "sofa") is None for _ in range(20))


def test_what_cannot_be_used_is_counted_by_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(models, "MAX_FACES", 30)
    holes = np.zeros((4, 4, 4), np.uint8)
    names = {
        "Table": table(), "Elevator": table(), "Desk": [*table(), *table()],
        "Chair": table(90, 90, 90), "Sofa": square(holes, "MASK"), "Bed": [],
    }  # fmt: skip
    folder = write_furniture(tmp_path, names)
    records = json.loads((folder / "catalog.json").read_text())
    licences = {"Table": "CC-BY-3.0-US"}
    for licence in ("GPL-2+ / CC-BY-3.0", "CC-BY-NC-4.0", "CC-BY-SA-3.0", "mit"):
        records.append({**records[0], "file": f"{len(records)}.glb", "license": licence})
    for record in records:
        record["license"] = licences.get(record["file"][:-4], record["license"])
    (folder / "catalog.json").write_text(json.dumps(records))
    catalogue = FurnitureCatalogue.open(folder)
    assert [entry.credit for entry in catalogue.entries] == ["Table (Table) by Ada, CC-BY-3.0-US"]
    assert catalogue.left_out == {
        "of no class of the rooms": 1,
        "more than 30 faces": 1,
        "longest side outside 0.02 to 6 m": 1,
        "cut out by transparency": 1,
        "without triangles": 1,
        "licence other than CC0, CC-BY, MIT": 4,
    }


def test_a_catalogue_of_nothing_usable_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"no model that rooms can use \(1 of no class"):
        FurnitureCatalogue.open(write_furniture(tmp_path, {"Elevator": table()}))
    with pytest.raises(ValueError, match=r"no model that rooms can use \(it is empty\)"):
        FurnitureCatalogue.open(write_furniture(tmp_path / "empty", {}))
    with pytest.raises(FileNotFoundError, match=r"there is no file .*catalog\.json"):
        FurnitureCatalogue.open(tmp_path / "none")


BAD_RECORDS = {
    "record 1 names a file outside the folder": {"file": "../Table.glb"},
    "record 1 lacks license": {"license": None},
    "3 is no text": {"creator": 3},
    "is no line of text": {"creator": "Ada\nand others"},
    "'high' is no number": {"elevation_m": "high"},
}


@pytest.mark.parametrize("reason", BAD_RECORDS)
def test_a_record_that_cannot_be_is_refused_with_the_reason(tmp_path, reason):
    folder = write_furniture(tmp_path, {"Table": table()})
    (record,) = json.loads((folder / "catalog.json").read_text())
    record = {key: v for key, v in {**record, **BAD_RECORDS[reason]}.items() if v is not None}
    (folder / "catalog.json").write_text(json.dumps([record]))
    with pytest.raises(ValueError, match=rf"catalog\.json is damaged \(.*{reason}"):
        FurnitureCatalogue.open(folder)


def test_two_files_of_one_name_are_refused(tmp_path):
    folder = write_furniture(tmp_path, {"Table": table()})
    (record,) = json.loads((folder / "catalog.json").read_text())
    other = {**record, "file": "more/Table.glb"}
    (folder / "catalog.json").write_text(json.dumps([record, other]))
    with pytest.raises(ValueError, match="two records name a file 'Table'"):
        FurnitureCatalogue.open(folder)


def test_a_missing_or_damaged_model_is_named(tmp_path):
    folder = write_furniture(tmp_path, {"Table": table(), "Desk": b"glTF"})
    with pytest.raises(ValueError, match=r"Desk\.glb is damaged"):
        FurnitureCatalogue.open(folder)
    (folder / "Desk.glb").unlink()
    with pytest.raises(FileNotFoundError, match=r"there is no file .*Desk\.glb"):
        FurnitureCatalogue.open(folder)


def test_a_damaged_catalogue_is_read_or_refused_in_one_line(tmp_path):
    folder = write_furniture(tmp_path, {"Table": table()}, elevation_m=0.1)
    path = folder / "catalog.json"

    def read() -> None:
        try:
            FurnitureCatalogue.open(folder)
        except FileNotFoundError as error:  # of a model under another name
            raise ValueError(f"{path}: {error}") from error
        except ValueError as error:
            if "no model that rooms can use" not in str(error):
                raise

    assert survive(path, read, of_json, 200)


def test_the_models_of_sweet_home_3d_are_furniture_of_the_right_size(shared: Path):
    folder = shared / "data" / "furniture_sweethome3d"
    if not folder.is_dir():
        pytest.skip("the furniture models are not here")
    catalogue = FurnitureCatalogue.open(folder)
    assert len(catalogue.entries) > 200
    assert len({entry.use for entry in catalogue.entries}) > 35
    sizes = {
        record["file"]: (record["width_m"], record["depth_m"], record["height_m"])
        for record in json.loads((folder / "catalog.json").read_text())
    }
    for entry in catalogue.entries[::12]:
        model = load_model(folder / entry.file, class_of(entry.use))
        assert model.size == pytest.approx(sizes[entry.file.as_posix()], abs=0.02)
