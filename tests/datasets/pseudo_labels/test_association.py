"""The association alone: the truth proposes and tracks, damaged in one known way at a time."""

from dataclasses import replace

import numpy as np
import pytest

from fake_rooms import fake_scene
from instok3d.datasets.pseudo_labels import association
from instok3d.datasets.pseudo_labels.association import AssociationConfig, label_clip
from true_masks import Damage, TrueClip, TrueMasks, boxes_clip, id_consistency

STEP_4 = AssociationConfig(keyframe_step=4, min_area_share=0.0)
WHOLE = Damage()
STANDING = (2, 2, 8, 8)


def labelled(
    clip: TrueClip, damage: Damage = WHOLE, config: AssociationConfig = STEP_4
) -> tuple[np.ndarray, TrueMasks]:
    truth = TrueMasks(clip, damage)
    return np.stack(list(label_clip(iter(clip.images), truth, truth, config))), truth


def ids_of(labels: np.ndarray, clip: TrueClip, name: int) -> list[set[int]]:
    """The ids on a true thing, frame by frame."""
    frames = zip(labels, clip.ids, strict=True)
    return [set(np.unique(found[true == name]).tolist()) for found, true in frames]


def two_boxes(num_frames: int) -> TrueClip:
    """A box that stands and one that moves a pixel a frame."""
    return boxes_clip([{1: STANDING, 2: (9, 10 + k, 14, 16 + k)} for k in range(num_frames)])


def test_whole_tracks_give_the_truth_but_for_names():
    clip = two_boxes(10)
    labels, truth = labelled(clip)
    # the surest mask, of thing 2, is named first
    np.testing.assert_array_equal(labels, np.array([0, 2, 1])[clip.ids])
    assert labels.dtype == np.uint16
    assert truth.proposed_on == [0, 4, 8, 9]  # every fourth and the last


def test_a_new_thing_is_followed_back_to_where_it_came_up():
    clip = boxes_clip([{1: STANDING} | ({2: (9, 9, 14, 14)} if k >= 2 else {}) for k in range(6)])
    labels, _ = labelled(clip)
    assert ids_of(labels, clip, 2) == [set(), set(), {2}, {2}, {2}, {2}]


def test_a_thing_missed_on_a_keyframe_is_found_on_the_next():
    clip = two_boxes(9)
    labels, _ = labelled(clip, Damage(unproposed=frozenset({(2, 0)})))
    # the map of frame 0 was final when frame 4 came
    assert ids_of(labels, clip, 2) == [{0}, *[{2}] * 8]


@pytest.mark.parametrize("lost_in", [5, 6, 7, 8])
def test_a_track_that_breaks_keeps_its_id_and_its_gap_is_closed(lost_in):
    clip = two_boxes(12)
    labels, _ = labelled(clip, Damage(lost=frozenset({(2, lost_in)})))
    assert ids_of(labels, clip, 2) == [{1}] * 12
    assert id_consistency(labels, clip.ids) == 1


def test_breaks_without_an_overlap_to_see_become_new_ids():
    clip = two_boxes(12)
    # lost in 6; the mask of keyframe 8 has another thing's overlap only: links need 100 %
    damage = Damage(lost=frozenset({(2, 6)}), jitter=1)
    labels, _ = labelled(clip, damage, replace(STEP_4, link_iou=1.0))
    assert len(np.unique(labels[labels > 0])) == 3


def test_a_hidden_thing_keeps_its_id_as_long_as_the_tracker_remembers_it():
    # thing 3 stands before thing 1 in frames 3 to 6
    clip = boxes_clip(
        [{1: STANDING, 2: (9, 20, 14, 30)} | ({3: (0, 0, 14, 14)} if 3 <= k <= 6 else {})
         for k in range(12)]
    )  # fmt: skip
    remembered, _ = labelled(clip)
    assert ids_of(remembered, clip, 1) == [{2}] * 3 + [set()] * 4 + [{2}] * 5
    assert id_consistency(remembered, clip.ids) == 1

    forgotten, _ = labelled(clip, Damage(memory=2))
    assert ids_of(forgotten, clip, 1)[7:] == [{4}] * 5
    # last seen in 2, back in 7: a gap of 5
    again, _ = labelled(clip, Damage(memory=2), replace(STEP_4, reentry_frames=5))
    np.testing.assert_array_equal(again, remembered)
    too_late, _ = labelled(clip, Damage(memory=2), replace(STEP_4, reentry_frames=4))
    np.testing.assert_array_equal(too_late, forgotten)


def test_what_comes_back_elsewhere_is_new_whatever_the_time():
    clip = boxes_clip(
        [{1: STANDING} if k < 3 else {} if k < 7 else {1: (2, 20, 8, 26)} for k in range(12)]
    )
    labels, _ = labelled(clip, Damage(memory=2), replace(STEP_4, reentry_frames=50))
    assert ids_of(labels, clip, 1) == [{1}] * 3 + [set()] * 4 + [{2}] * 5


def test_tracks_that_run_into_one_are_one_and_the_left_thing_gets_its_id_back():
    clip = two_boxes(12)
    labels, _ = labelled(clip, Damage(drift={(1, 6): 2}))
    # 2 is the younger track, of thing 1; in 6 and 7 it lay on thing 2
    assert ids_of(labels, clip, 2) == [{1}] * 12
    assert ids_of(labels, clip, 1) == [{2}] * 12


def test_the_younger_of_two_like_tracks_ends():
    clip = two_boxes(9)
    labels, truth = labelled(clip, Damage(drift={(1, 2): 2}, unproposed=frozenset({(1, 4)})))
    assert ids_of(labels, clip, 2) == [{1}] * 9  # 1 is the elder
    assert set(truth.sessions[0].tracks) == {1, 3}
    # 1 was not proposed in keyframe 4 and found anew in 8, too late to know it by the past
    assert ids_of(labels, clip, 1) == [{2}] * 2 + [{0}] * 3 + [{3}] * 4


def test_parts_of_a_thing_lie_on_it_as_things_of_their_own():
    clip = two_boxes(6)
    labels, _ = labelled(clip, Damage(split=frozenset({(1, 4)})))
    # a third overlaps the whole by 1/3 and is new, the rest by 2/3 and is known
    assert ids_of(labels, clip, 1) == [{2}] + [{2, 3}] * 5


def test_a_mask_that_unites_known_things_is_no_new_thing():
    boxes = {1: (2, 2, 6, 6), 2: (2, 6, 6, 10), 3: (2, 10, 6, 14)}
    clip = boxes_clip([boxes] * 6)
    united = Damage(united=((4, (1, 2, 3)),))
    labels, _ = labelled(clip, united)
    assert len(np.unique(labels)) == 4  # with 0
    hidden_too = replace(STEP_4, min_visible_share=0.0)
    assert len(np.unique(labelled(clip, united, hidden_too)[0])) == 5


def test_tiny_masks_are_no_things():
    clip = boxes_clip([{1: STANDING, 2: (9, 9, 10, 11)}] * 3)  # 2 of 512 pixels
    labels, _ = labelled(clip, config=replace(STEP_4, min_area_share=3 / 512))
    assert ids_of(labels, clip, 2) == [{0}] * 3
    labels, _ = labelled(clip, config=replace(STEP_4, min_area_share=2 / 512))
    assert ids_of(labels, clip, 2) == [{1}] * 3


def test_a_long_clip_holds_few_frames_and_no_tracks_of_long_ago():
    # a new box every 4 frames, seen for 4, at another place
    places = [(2 + 3 * (k % 3), 2 + 7 * (k % 4), 5 + 3 * (k % 3), 7 + 7 * (k % 4))
              for k in range(30)]  # fmt: skip
    clip = boxes_clip([{k // 4 + 1: places[k // 4]} for k in range(120)])
    truth, taken = TrueMasks(clip), []

    def images():
        for number, image in enumerate(clip.images):
            taken.append(number)
            yield image

    labels = []
    for labels_out, id_map in enumerate(
        label_clip(images(), truth, truth, replace(STEP_4, forget_after=8))
    ):
        assert len(taken) <= labels_out + 4 + 2  # a step of frames, and one to know the last
        labels.append(id_map)
    assert len(labels) == 120
    assert len(np.unique(labels)) == 31  # with 0
    assert truth.sessions[0].most_tracks <= 4  # of 30: those of the last 8 frames, and the new


def test_forgotten_things_come_back_with_new_ids():
    clip = boxes_clip([{1: STANDING} if k < 3 or k >= 14 else {} for k in range(20)])
    kept, _ = labelled(clip)
    assert ids_of(kept, clip, 1)[14:] == [{1}] * 6
    forgotten, _ = labelled(clip, config=replace(STEP_4, forget_after=8))
    assert ids_of(forgotten, clip, 1)[14:] == [{2}] * 6


def test_clips_of_nothing_and_of_one_frame():
    truth = TrueMasks(two_boxes(1))
    assert list(label_clip([], truth, truth)) == []
    one, _ = labelled(two_boxes(1))
    assert np.unique(one).tolist() == [0, 1, 2]
    nothing, _ = labelled(boxes_clip([{}] * 5))
    assert nothing.shape == (5, 16, 32)
    assert not nothing.any()


def test_frames_of_two_sizes_are_refused():
    clip, other = two_boxes(2), boxes_clip([{}], size=(8, 8))
    truth = TrueMasks(clip)
    with pytest.raises(ValueError, match="8x8 follows one of 16x32; all frames"):
        list(label_clip(iter([*clip.images, *other.images]), truth, truth))


def test_more_tracks_than_16_bits_hold_are_refused(monkeypatch):
    monkeypatch.setattr(association, "MAX_TRACKS", 1)
    with pytest.raises(ValueError, match="more than 1 tracks by frame 0; cut it into shorter"):
        labelled(two_boxes(3))


@pytest.mark.parametrize(
    "wrong", [{"keyframe_step": 0}, {"match_iou": 1.5}, {"reentry_frames": -1}, {"link_iou": -0.1}]
)
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        AssociationConfig(**wrong)


def random_damage(clip: TrueClip, seed: int, *, rate: float) -> Damage:
    """Every id is left out of the proposals, and lost by its tracks, at this rate a frame."""
    rng = np.random.default_rng(seed)
    names = np.unique(clip.ids[clip.ids > 0]).tolist()
    pairs = [(name, frame) for name in names for frame in range(len(clip.ids))]

    def some() -> frozenset[tuple[int, int]]:
        return frozenset(pair for pair in pairs if rng.random() < rate)

    return Damage(unproposed=some(), lost=some(), memory=2, jitter=1)


def test_damaged_tracks_through_a_fake_room_mostly_keep_their_ids():
    scene = fake_scene(seed=0, size=48, num_frames=48)
    clip = TrueClip(np.asarray(scene.images), np.asarray(scene.instances))
    damage = random_damage(clip, seed=0, rate=0.1)
    config = replace(STEP_4, keyframe_step=6)
    labels, _ = labelled(clip, damage, config)
    linked = id_consistency(labels, clip.ids)
    # the same without links: breaks stay breaks
    alone, _ = labelled(clip, damage, replace(config, link_iou=1.0))
    broken = id_consistency(alone, clip.ids)
    print("id consistency in a damaged fake room", linked, broken)
    assert linked > 0.8
    assert linked > broken + 0.3


@pytest.fixture(scope="module")
def room() -> TrueClip:
    pytest.importorskip("embreex")
    from instok3d.rooms.denoising import find_denoiser
    from instok3d.rooms.scene import render_scene

    scene = render_scene(1, resolution=64, denoiser=find_denoiser())
    assert scene is not None
    return TrueClip(np.asarray(scene.images), np.asarray(scene.instances).astype(np.int64))


def test_whole_tracks_through_a_rendered_room_keep_every_id(room):
    config = AssociationConfig(keyframe_step=5, min_area_share=0.0, min_visible_share=0.0)
    labels, _ = labelled(room, config=config)
    assert id_consistency(labels, room.ids) > 0.98


def test_damaged_tracks_through_a_rendered_room_mostly_keep_their_ids(room):
    config = AssociationConfig(keyframe_step=5)
    scores = []
    for seed in range(3):
        damage = random_damage(room, seed, rate=0.05)
        for settings in (config, replace(config, link_iou=1.0)):
            scores.append(id_consistency(labelled(room, damage, settings)[0], room.ids))
    linked, broken = scores[::2], scores[1::2]
    print("id consistency in a damaged room", linked, broken)
    assert min(linked) > 0.8
    assert np.mean(linked) > np.mean(broken) + 0.05
