# InsTok3D on the processor. docs/containers.md says how to build and run it.
FROM python:3.13.1-slim-bookworm AS build
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends g++ \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
# What the image was built from, for `instok3d --version`: git is left outside.
ARG COMMIT=""
# Without OpenMP, as released wheels: PyTorch in the other stage brings its own.
RUN if [ -n "$COMMIT" ]; then echo "$COMMIT" > COMMIT; fi \
    && pip wheel --no-cache-dir --no-deps --wheel-dir /wheels \
        --config-settings cmake.define.INSTOK3D_OPENMP=OFF .

FROM python:3.13.1-slim-bookworm
# The address of PyTorch's CPU wheels; and more of the package, such as [view,models].
ARG PIP_EXTRA_INDEX_URL=""
ARG EXTRAS=""
COPY constraints-cpu.txt /tmp/
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \
    pip install --no-cache-dir --constraint /tmp/constraints-cpu.txt "$(echo /wheels/*.whl)$EXTRAS" \
    && useradd --create-home --uid 1000 instok3d && install -d -o 1000 /work
USER 1000:1000
WORKDIR /work
ENTRYPOINT ["instok3d"]
CMD ["demo"]
