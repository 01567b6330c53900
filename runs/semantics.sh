#!/usr/bin/env bash
# The default model's semantics: text table, embedded teacher, distillation, calibration, figures.
#
#     [FURNITURE=DIR] [TEXTURES=DIR] MINILM=DIR bash runs/semantics.sh FOLDER [--dry-run | --small]
#
# MINILM is the folder that runs/text_table.py takes; WordNet's database is where Debian's package
# wordnet-base puts it. FURNITURE and TEXTURES are catalogues for the rooms of level real
# (docs/data.md), whose authors the file then credits.
#
# Everything goes into FOLDER, the semantics into FOLDER/semantics.safetensors, the figures into
# FOLDER/*.md. Stop it at any time and run it again: it goes on. --dry-run prints what the distillation
# would do and takes, and writes nothing. --small shows that the parts fit together: nothing good.
# Times: docs/models.md.
set -euo pipefail

folder=${1:?"give the folder for rooms, runs and the semantics"}
mode=${2:-}
here=$(dirname "$0")
shipped=$here/../src/instok3d/assets/default_model.safetensors
minilm=${MINILM:-}
train_seeds=0:640 real_seeds=10000:10224 test_seeds=2000000:2000100 workers=2 seed=16
catalogues=(${FURNITURE:+--furniture "$FURNITURE"} ${TEXTURES:+--textures "$TEXTURES"})
teacher_minutes=80 steps=1200 scenes=100
settings=()
case $mode in
    "") ;;
    --small)
        train_seeds=0:32 real_seeds=10000:10016 test_seeds=2000000:2000002 scenes=1
        teacher_minutes=0.2 steps=2
        settings=(--holdout 2)
        ;;
    --dry-run) settings=(--dry-run) ;;
    *)
        echo "unknown option $mode; there are --dry-run and --small" >&2
        exit 2
        ;;
esac
rooms=("$folder/rooms" "$folder/rooms-real")
table=$folder/table.safetensors teacher=$folder/teacher/teacher.safetensors
semantics=$folder/semantics.safetensors
notes="Distilled from an encoder that was trained on rendered rooms alone (generator version 1, seeds $train_seeds; level real, seeds $real_seeds). Apache-2.0."

if [ "$mode" != --dry-run ]; then
    : "${minilm:?"set MINILM to the folder of the sentence model, see runs/text_table.py"}"
    mkdir -p "$folder"
    instok3d data rooms -o "$folder/rooms" --seeds "$train_seeds" --workers "$workers"
    instok3d data rooms -o "$folder/rooms-real" --seeds "$real_seeds" --workers "$workers" \
        --level real ${catalogues[@]+"${catalogues[@]}"}
    instok3d data rooms -o "$folder/rooms-test" --seeds "$test_seeds" --workers "$workers"
    if [ ! -e "$table" ]; then python "$here/text_table.py" "$minilm" -o "$table"; fi
    python "$here/teacher.py" --rooms "${rooms[@]}" --table "$table" --start "$shipped" \
        -o "$folder/teacher" --minutes "$teacher_minutes" --batch 8 --lr 8e-4 --encoder-lr 0.5 \
        --frozen 0 --small-share 0.5 --seed "$seed"
fi

resume=()
if compgen -G "$folder/distillation/checkpoints/step_*.pt" >/dev/null; then resume=(--resume); fi
instok3d train nano-semantics --data "${rooms[@]}" -o "$folder/distillation" --init-from "$shipped" \
    --stage.teacher "rooms:$teacher" --lr 8e-4 --ema-decay 0.99 --steps "$steps" --seed "$seed" \
    ${settings[@]+"${settings[@]}"} ${resume[@]+"${resume[@]}"}
if [ "$mode" = --dry-run ]; then exit; fi
if [ ! -e "$semantics" ]; then
    instok3d train export "$folder/distillation" -o "$semantics" --notes "$notes"
    python "$here/query_table.py" "${rooms[@]}" --fit --objects --semantics "$semantics" --write
fi

# figure NAME SCRIPT ARGUMENT ...: measured once.
figure() {
    local file=$folder/$1.md script=$here/$2
    shift 2
    if [ -e "$file" ]; then return; fi
    python "$script" "$folder/rooms-test" "$@" --semantics "$semantics" --scenes "$scenes" >"$file.part"
    mv "$file.part" "$file"
}
figure lifting semantic_table.py
for views in 2 4 8; do
    figure "queries-$views" query_table.py --objects --views "$views"
done
