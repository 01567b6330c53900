#!/usr/bin/env bash
# The whole way of the paper's model at toy size: ScanNet files, backbone, cache, tokenizer, figures.
#
#     bash runs/rehearsal.sh FOLDER [--small]
#
# Rendered rooms stand in for ScanNet, in its own file formats; the shipped model's backbone stands
# in for the published one; the tokenizer trains on two processes, is killed (SIGKILL) and goes on.
# It shows that the parts fit together; nothing good comes out of so few steps. FOLDER must be new.
set -euo pipefail

folder=${1:?"give a new folder for data, runs and the model"}
size=${2:-}
here=$(dirname "$0")
rooms=0:32 resolution=128 training_scans=26 test_scans=6 holdout=4 adapt_steps=40 steps=60 save_steps=20
if [ "$size" = --small ]; then
    rooms=0:4 resolution=64 training_scans=3 test_scans=1 holdout=1 adapt_steps=2 steps=4 save_steps=2
elif [ -n "$size" ]; then
    echo "unknown option $size" >&2
    exit 2
fi
settings=(--seed 0 --device cpu --threads 1 --holdout "$holdout")
batches=(--batches.views 2 --batches.batch-size 2)
fixed=(--batches.samples-per-scene 2)

mkdir "$folder"
instok3d data rooms -o "$folder/rooms" --seeds "$rooms" --resolution "$resolution" --workers 2
python "$here/rooms_as_scannet.py" "$folder/rooms" -o "$folder/scannet" \
    --training "$training_scans" --test "$test_scans"

instok3d data prepare scannet "$folder/scannet" -o "$folder/prepared" \
    --size "$resolution" --stride 1 --min-frames 1 --workers 2
instok3d data verify "$folder/prepared"

shipped=$here/../src/instok3d/assets/default_model.safetensors
instok3d train nano-adapt --data "$folder/prepared" -o "$folder/adapt" --init-from "$shipped" \
    "${settings[@]}" "${batches[@]}" --steps "$adapt_steps"

instok3d train cache --data "$folder/prepared" -o "$folder/features" \
    --init-from "$folder/adapt" "${settings[@]}" "${batches[@]}" "${fixed[@]}"

tokenizer=(torchrun --standalone --nproc-per-node 2 -m instok3d train nano-tokenizer
    --data "$folder/prepared" -o "$folder/tokenizer")
new=("${settings[@]}" "${batches[@]}" "${fixed[@]}" --stage.cache "$folder/features"
    --steps "$steps" --checkpoint-every-steps "$save_steps")
python "$here/killed_once.py" "$folder/tokenizer" -- "${tokenizer[@]}" "${new[@]}"
"${tokenizer[@]}" --resume

instok3d train export "$folder/tokenizer" -o "$folder/model.safetensors"
instok3d evaluate scannet-2view --data "$folder/prepared" --model "$folder/model.safetensors" \
    --json --details >"$folder/scannet-2view.json"
cat "$folder/scannet-2view.json"
