#!/usr/bin/env bash
# Simulates snaps that are pressed deeper and deeper, 0.05 to 1.5 mm, into DIR/OPTICS-KIND/DEPTH: weights/presses.sh DIR
# One seed for all depths of a folder, so that a picture of each shows the same snap.
# SMR_GPU names the program; a set that is there is left as it is.
set -euo pipefail
dir=${1:?"a folder"}
smr_gpu=${SMR_GPU:-target/release/smr-gpu}

press() {
    local name=$1 seed=$2 force=$3
    for step in $(seq 1 30); do
        local depth
        depth=$(printf '%d.%02d' $((step * 5 / 100)) $((step * 5 % 100)))
        # That shows about 20 hooks and 10 studs.
        "$smr_gpu" simulate --out "$dir/$name-a/$depth" --seed "$seed" --count 12 --conditions wide --kind a --force "$force,side=no,depth=$depth"
        "$smr_gpu" simulate --out "$dir/$name-b/$depth" --seed "$((seed + 1))" --count 7 --conditions wide --kind b --force "$force,depth=$depth"
    done
}

press lamps 19501 mild,strength=3,shadows=0.5
press mini 19503 mild,frame=gelsight-mini
press dark 19505 darkness=0.4..0.9,strength=0.1..1,colour=-1..0.2
