# What a workload's container is made from. `matrix` sends this file and the static binary to the engine itself: nothing
# is pulled, so that no registry is needed. BASE is `scratch`, or the image that a matrix file names under
# `providers.docker.image`, which must be on the engine.
ARG BASE=scratch
FROM ${BASE}
COPY workload /workload
USER 0:0
WORKDIR /
ENTRYPOINT ["/workload"]
CMD []
