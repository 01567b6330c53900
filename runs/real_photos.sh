#!/usr/bin/env bash
# The default model's last step, for photos of real cameras: the tokenizer trained on, on rooms of all
# levels and of level real whose photos go through a random camera (docs/training.md), and the mean of
# the weights before and after it.
#
#     [START=FILE] [FURNITURE=DIR] [TEXTURES=DIR] bash runs/real_photos.sh FOLDER [--dry-run | --small]
#
# START is the model to begin with, that of runs/default_model.sh; the shipped one without it.
# FURNITURE and TEXTURES are catalogues for the rooms of level real (docs/data.md); without them those
# rooms are furnished by this code alone.
#
# Everything goes into FOLDER, the model into FOLDER/real_photos.safetensors, the figures into
# FOLDER/*.md. Stop it at any time and run it again: finished rooms and figures are kept and training
# goes on from the newest checkpoint. --dry-run prints what the training run would do and takes, and
# writes nothing. --small shows that the parts fit together: two steps on eight rooms, nothing good.
# Times and what it gave: docs/models.md.
set -euo pipefail

folder=${1:?"give the folder for rooms, runs and the model"}
mode=${2:-}
here=$(dirname "$0")
start=${START:-$here/../src/instok3d/assets/default_model.safetensors}
train_seeds=0:496 real_seeds=10000:10224 test_seeds=2000000:2000100 workers=2
catalogues=(${FURNITURE:+--furniture "$FURNITURE"} ${TEXTURES:+--textures "$TEXTURES"})
steps=2200
settings=() scenes=20
notes="Trained on rendered rooms alone (generator version 1), last on seeds $train_seeds and, of level real, $real_seeds, their photos through a random camera. Apache-2.0."
case $mode in
    "") ;;
    --small)
        train_seeds=0:8 real_seeds=10000:10008 test_seeds=2000000:2000002 scenes=1
        steps=2
        settings=(--holdout 2 --batches.batch-size 2)
        ;;
    --dry-run) settings=(--dry-run) ;;
    *)
        echo "unknown option $mode; there are --dry-run and --small" >&2
        exit 2
        ;;
esac

if [ "$mode" != --dry-run ]; then
    mkdir -p "$folder"
    instok3d data rooms -o "$folder/rooms" --seeds "$train_seeds" --workers "$workers"
    instok3d data rooms -o "$folder/rooms-real" --seeds "$real_seeds" --workers "$workers" \
        --level real ${catalogues[@]+"${catalogues[@]}"}
    instok3d data rooms -o "$folder/rooms-test" --seeds "$test_seeds" --workers "$workers"
fi

resume=()
if compgen -G "$folder/tokenizer/checkpoints/step_*.pt" >/dev/null; then resume=(--resume); fi
# Saturation 1 lets photos be without any colour too.
instok3d train nano-tokenizer --data "$folder/rooms" "$folder/rooms-real" -o "$folder/tokenizer" \
    --init-from "$start" --seed 22 --batches.sensor.strength 1 --batches.sensor.saturation 1 \
    --batches.views 2 2 4 8 8 --batches.num-targets 2 --stage.seg-warmup-steps 1 \
    --stage.given-probability 0.25 --lr 1e-4 --steps "$steps" \
    ${settings[@]+"${settings[@]}"} ${resume[@]+"${resume[@]}"}
if [ "$mode" = --dry-run ]; then exit; fi
model=$folder/real_photos.safetensors
if [ ! -e "$model" ]; then
    instok3d train export "$folder/tokenizer" -o "$folder/end.safetensors" --notes "$notes"
    python "$here/mean_weights.py" "$start" "$folder/end.safetensors" --share 0.5 -o "$model"
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
