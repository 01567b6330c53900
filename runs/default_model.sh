#!/usr/bin/env bash
# The default model from nothing: rooms, geometry, refinement, tokenizer, export, figures.
#
#     bash runs/default_model.sh FOLDER
#
# Everything goes into FOLDER, the model into FOLDER/default_model.safetensors. Stop it at any time
# and run it again: finished rooms are kept and training goes on from the newest checkpoint.
# Times on one core of an Intel Xeon with AMX: rooms 2.2 h, geometry 5 h, refinement 0.3 h,
# tokenizer 11 h, evaluation 0.3 h. The shipped model is this recipe, not these bits: its runs took
# in more rooms on the way and were begun anew from each other's weights (docs/models.md).
set -euo pipefail

folder=${1:?"give the folder for rooms, runs and the model"}
train_seeds=0:4000
test_seeds=2000000:2000100
workers=2
seed=0
geometry_steps=16600
many_views_steps=7000
refinement_steps=1500
tokenizer_steps=15000
window_steps=4250
notes="Trained on rendered rooms alone (generator version 1, seeds $train_seeds); poor on real photos. Apache-2.0."

mkdir -p "$folder"
resume_of() { if compgen -G "$1/checkpoints/step_*.pt" >/dev/null; then echo --resume; fi; }

instok3d data rooms -o "$folder/rooms" --seeds "$train_seeds" --workers "$workers"
instok3d data rooms -o "$folder/rooms-test" --seeds "$test_seeds" --workers "$workers"

# shellcheck disable=SC2046  # no word on purpose where there is nothing to resume
instok3d train nano-geometry --data "$folder/rooms" -o "$folder/geometry" --seed "$seed" \
    --steps "$geometry_steps" $(resume_of "$folder/geometry")
# shellcheck disable=SC2046
instok3d train nano-geometry --data "$folder/rooms" -o "$folder/geometry-many" --seed "$seed" \
    --init-from "$folder/geometry" --batches.views 2 4 8 8 8 --lr 2.5e-4 \
    --steps "$many_views_steps" $(resume_of "$folder/geometry-many")
# shellcheck disable=SC2046
instok3d train nano-refinement --data "$folder/rooms" -o "$folder/refinement" --seed "$seed" \
    --init-from "$folder/geometry-many" --steps "$refinement_steps" \
    $(resume_of "$folder/refinement")
# shellcheck disable=SC2046
instok3d train nano-tokenizer --data "$folder/rooms" -o "$folder/tokenizer" --seed "$seed" \
    --init-from "$folder/refinement" --steps "$tokenizer_steps" $(resume_of "$folder/tokenizer")
# Windows of four, on the depth and cameras of eight views.
# shellcheck disable=SC2046
instok3d train nano-tokenizer --data "$folder/rooms" -o "$folder/tokenizer-many" --seed "$seed" \
    --init-from "$folder/tokenizer" --batches.views 2 4 8 8 8 8 --batches.num-targets 2 \
    --stage.seg-warmup-steps 1 --lr 1e-4 --steps "$window_steps" \
    $(resume_of "$folder/tokenizer-many")
instok3d train export "$folder/tokenizer-many" -o "$folder/default_model.safetensors" --notes "$notes"

for protocol in rooms-2view rooms-8view; do
    for geometry in predicted given; do
        instok3d evaluate "$protocol" --geometry "$geometry" --data "$folder/rooms-test" \
            --model "$folder/default_model.safetensors" --baselines --json --details \
            >"$folder/$protocol-$geometry.json"
    done
done
