# The program in a container: docker build -t scenesplat . && docker run --rm -v "$PWD:/data" scenesplat segment scan.ply --out labels
FROM rust:1-slim-bookworm AS build
WORKDIR /source
# For --version: docker build --build-arg COMMIT=$(git rev-parse HEAD) .
ARG COMMIT
ENV SCENESPLAT_COMMIT=${COMMIT:-unknown}
COPY . .
RUN cargo build --release --locked --bin scenesplat

# It needs nothing but the C library.
FROM debian:bookworm-slim
COPY --from=build /source/target/release/scenesplat /usr/local/bin/
COPY --from=build /source/LICENSE-APACHE /source/LICENSE-MIT /source/assets/embedded/ATTRIBUTION.md /usr/share/doc/scenesplat/
WORKDIR /data
ENTRYPOINT ["scenesplat"]
CMD ["--help"]
