#!/usr/bin/env bash
# `listen` and the HTTP server under attack: 20,000 damaged datagrams of each kind, 2,000 damaged
# requests, and 200 dead readers beside 64 clients that send requests endlessly and never read. A
# health check must be answered within a second throughout.
#   benches/network.sh [DATAGRAMS OF EACH KIND] [REQUESTS]
set -euo pipefail
cd "$(dirname "$0")/.."
run() { cargo test --release --test stagepose "$1" -- --nocapture --test-threads=1 2>&1 | grep -vE '^(running|$)'; }
STAGEPOSE_NETWORK_INPUTS="${1:-20000}" run network::datagrams
export STAGEPOSE_HEALTH_WITHIN_MS=1000
STAGEPOSE_NETWORK_INPUTS="${2:-2000}" run network::requests
run network::siege
