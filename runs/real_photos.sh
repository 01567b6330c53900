#!/usr/bin/env bash
# The default model trained on, for photos of real cameras: from the shipped weights, on rooms of all
# levels and as many of level real, whose photos go through a random camera (docs/training.md), with a
# focus on many views.
#
#     [FURNITURE=DIR] [TEXTURES=DIR] bash runs/real_photos.sh FOLDER [--dry-run | --small]
#
# FURNITURE and TEXTURES are catalogues for the rooms of level real (docs/data.md); without them those
# rooms are furnished by this code alone.
#
# Everything goes into FOLDER, the model into FOLDER/real_photos.safetensors, the figures into
# FOLDER/*.md. Stop it at any time and run it again: finished rooms and figures are kept and training
# goes on from the newest checkpoint. --dry-run prints what each training run would do and takes, and
# writes nothing. --small shows that the parts fit together: two steps on eight rooms, nothing good.
# Plan and times: docs/models.md.
set -euo pipefail

folder=${1:?"give the folder for rooms, runs and the model"}
mode=${2:-}
here=$(dirname "$0")
shipped=$here/../src/instok3d/assets/default_model.safetensors
train_seeds=0:1600 real_seeds=10000:13200 test_seeds=2000000:2000100 workers=2 seed=21
catalogues=(${FURNITURE:+--furniture "$FURNITURE"} ${TEXTURES:+--textures "$TEXTURES"})
geometry_steps=8000 refinement_steps=1500 tokenizer_steps=9000
settings=() scenes=20
notes="Trained on rendered rooms alone (generator version 1, seeds $train_seeds; level real, seeds $real_seeds), their photos through a random camera. Apache-2.0."
case $mode in
    "") ;;
    --small)
        train_seeds=0:8 real_seeds=10000:10008 test_seeds=2000000:2000002 scenes=1
        geometry_steps=2 refinement_steps=2 tokenizer_steps=2
        settings=(--holdout 2 --batches.batch-size 2)
        ;;
    --dry-run) settings=(--dry-run) ;;
    *)
        echo "unknown option $mode; there are --dry-run and --small" >&2
        exit 2
        ;;
esac

resume_of() { if compgen -G "$1/checkpoints/step_*.pt" >/dev/null; then echo --resume; fi; }
# train PRESET RUN FIRST_WEIGHTS SETTING ...
train() {
    local preset=$1 run=$folder/$2 first=$3
    shift 3
    # shellcheck disable=SC2046  # no word on purpose where there is nothing to resume
    instok3d train "$preset" --data "$folder/rooms" "$folder/rooms-real" -o "$run" --init-from "$first" --seed "$seed" \
        --batches.sensor.strength 1 "$@" ${settings[@]+"${settings[@]}"} $(resume_of "$run")
}

if [ "$mode" != --dry-run ]; then
    mkdir -p "$folder"
    instok3d data rooms -o "$folder/rooms" --seeds "$train_seeds" --workers "$workers"
    instok3d data rooms -o "$folder/rooms-real" --seeds "$real_seeds" --workers "$workers" \
        --level real ${catalogues[@]+"${catalogues[@]}"}
    instok3d data rooms -o "$folder/rooms-test" --seeds "$test_seeds" --workers "$workers"
fi

train nano-geometry geometry "$shipped" --batches.views 2 2 4 8 8 --lr 2.5e-4 \
    --steps "$geometry_steps"
train nano-refinement refinement "$folder/geometry" --steps "$refinement_steps"

# The shipped tokenizer goes on, on the new geometry.
if [ "$mode" != --dry-run ] && [ ! -e "$folder/first.safetensors" ]; then
    python "$here/joined_weights.py" "$shipped" "$folder/refinement" -o "$folder/first.safetensors"
fi
train nano-tokenizer tokenizer "$folder/first.safetensors" --batches.views 2 4 8 8 8 8 \
    --batches.num-targets 2 --stage.seg-warmup-steps 1 --lr 1e-4 --steps "$tokenizer_steps"
if [ "$mode" = --dry-run ]; then exit; fi
model=$folder/real_photos.safetensors
if [ ! -e "$model" ]; then
    instok3d train export "$folder/tokenizer" -o "$model" --notes "$notes"
fi

# figure NAME PROTOCOL SETTING ...: measured once.
figure() {
    local file=$folder/$1.md
    shift
    if [ -e "$file" ]; then return; fi
    instok3d evaluate "$@" --data "$folder/rooms-test" --model "$model" --markdown >"$file.part"
    mv "$file.part" "$file"
}
few=(--scenes "$scenes" --targets-per-scene 2)
all=()
if [ "$mode" = --small ]; then all=(--scenes "$scenes"); fi
for geometry in predicted given; do
    for protocol in rooms-2view rooms-8view; do
        figure "$protocol-$geometry" "$protocol" --geometry "$geometry" ${all[@]+"${all[@]}"}
    done
done
for refine in 0 100; do
    figure "clean-$refine" rooms-2view "${few[@]}" --refine "$refine"
    for photos in hard jpeg30 noise8 exposure20 focal1.33 focal2 grey overexposed; do
        figure "$photos-$refine" rooms-2view "${few[@]}" --refine "$refine" --disturb "$photos"
    done
done
