# InsTok3D on a CUDA GPU. docs/containers.md says how to build and run it.
# With nvcc, by which gsplat compiles its kernels when they are first used.
FROM nvidia/cuda:13.0.1-devel-ubuntu24.04
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends g++ python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
ENV PATH=/opt/venv/bin:$PATH
# PyTorch first: its build must be of the same CUDA as nvcc above.
ARG TORCH=2.11.0
RUN python3 -m venv /opt/venv && pip install --no-cache-dir "torch==$TORCH"
WORKDIR /source
COPY . .
ARG COMMIT=""
ARG EXTRAS="[gpu,models]"
# hadolint ignore=DL3013
RUN if [ -n "$COMMIT" ]; then echo "$COMMIT" > COMMIT; fi \
    && pip install --no-cache-dir --config-settings cmake.define.INSTOK3D_OPENMP=OFF ".$EXTRAS" \
    && rm -rf build \
    && useradd --create-home --uid 1001 instok3d && install -d -o 1001 /work /cache
# Compiled kernels and weights; a volume keeps them.
ENV TORCH_EXTENSIONS_DIR=/cache/torch_extensions INSTOK3D_HOME=/cache/instok3d HF_HOME=/cache/hub
USER 1001:1001
WORKDIR /work
ENTRYPOINT ["instok3d"]
CMD ["demo"]
