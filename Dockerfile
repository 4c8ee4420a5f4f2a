# Image for tests of pipelines against the virtual rig; docs/how-to/testing.md says how to run it.
FROM python:3.12-slim
COPY . /source
# a compiler only while the kernels are built
RUN apt-get update && apt-get install --yes --no-install-recommends gcc libc6-dev \
    && pip install --no-cache-dir numba==0.68.1 "setuptools<80" \
    && pip install --no-cache-dir --no-build-isolation "/source[wheels,strategies,test]" pytest-xdist \
    && apt-get purge --yes gcc libc6-dev && apt-get autoremove --yes && rm -rf /source /var/lib/apt/lists/*
RUN useradd --create-home --uid 1000 tester
USER tester
WORKDIR /home/tester
ENV ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg
CMD ["pytest", "--help"]
