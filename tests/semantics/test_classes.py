from instok3d.semantics.classes import LSM_CLASSES, LSM_OF_ROOM, OTHER, ROOM_CLASSES, lsm_class


def test_each_class_of_the_rooms_has_its_class_of_lsm():
    found = {label: LSM_CLASSES[lsm_class(label)] for label in ROOM_CLASSES}
    assert found["armchair"] == "chair"
    assert found["coffee table"] == found["side table"] == "table"
    assert found["desk"] == found["rug"] == found["door"] == "other"
    assert {name for name in found.values() if name != "other"} == set(LSM_CLASSES) - {"other"}
    assert [LSM_CLASSES[place] for place in LSM_OF_ROOM] == list(found.values())


def test_an_unknown_class_is_other():
    assert lsm_class("submarine") == OTHER
