"""What `make bench` runs: one file per part, each with `run() -> dict` of the flat keys of build/bench.json."""
