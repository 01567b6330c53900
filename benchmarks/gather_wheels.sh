#!/usr/bin/env bash
# Fetches, with pip, what a GPU machine without network lacks to run benchmarks/gpu.py. It is taken
# to have Python, torch with CUDA, nvcc and a C++ compiler. Wheels for x86-64 Linux.
#
#     benchmarks/gather_wheels.sh FOLDER [PYTHON_VERSION [PACKAGE ...]]
#
# Without names all packages are fetched, 100 MB, of which scipy, cmake and numpy are 80: name those
# that are missing there if less can be carried. There, in the project's folder:
#
#     pip install --no-index --no-deps FOLDER/*.whl
#     pip install --no-index --no-deps --no-build-isolation -e .
#     python benchmarks/gpu.py --out DIR
set -euo pipefail
folder=${1:?give a folder for the wheels}
python=${2:-3.12}

# The package's own dependencies but torch, with theirs; gsplat; what builds and tests it. gsplat's
# wheel holds sources, which nvcc compiles when it is first imported.
packages=(
    numpy scipy pillow safetensors tqdm
    jaxtyping wadler-lindig tyro docstring-parser typeguard typing-extensions
    gsplat==1.5.3 rich markdown-it-py mdurl pygments
    scikit-build-core pathspec packaging nanobind cmake ninja
    beartype pytest pluggy iniconfig
)
if (($# > 2)); then packages=("${@:3}"); fi
platforms=()
for glibc in 2_28 2_27 2_24 2_17 2_12 2_5; do
    platforms+=(--platform "manylinux_${glibc}_x86_64")
done
platforms+=(--platform manylinux2014_x86_64 --platform manylinux1_x86_64)

for package in "${packages[@]}"; do
    python3 -m pip download -q --no-deps --only-binary=:all: --implementation cp \
        --python-version "$python" "${platforms[@]}" -d "$folder" "$package"
done
du -sh "$folder"
