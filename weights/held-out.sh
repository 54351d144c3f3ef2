#!/usr/bin/env bash
# Simulates the held-out sets, one a condition, into DIR/NAME: weights/held-out.sh DIR
# SMR_GPU names the program; a set that is there is left as it is.
set -euo pipefail
dir=${1:?"a folder"}
smr_gpu=${SMR_GPU:-target/release/smr-gpu}

set_of() {
    local name=$1 seed=$2 count=$3
    shift 3
    "$smr_gpu" simulate --out "$dir/$name" --seed "$seed" --count "$count" "$@"
}
snaps() {
    local name=$1 seed=$2
    shift 2
    set_of "$name" "$seed" 200 --conditions wide "$@"
}
look_alike() {
    set_of "$1" "$2" 100 --conditions wide --kind none --look-alike "$3"
}

# The paper's sensor.
set_of plain-a 19001 200 --kind a
set_of plain-b 19002 200 --kind b

# All conditions at once.
snaps wide-a 19011 --kind a
snaps wide-b 19012 --kind b
snaps wide-mixed 19013 --kind mixed

# One condition; `mild` takes the paper's frame and draws weakly what is not named.
snaps markers-a 19021 --kind a --force mild,markers=2
snaps markers-b 19022 --kind b --force mild,markers=2
snaps mottle-a 19031 --kind a --force mild,mottle=0.05
snaps mottle-b 19032 --kind b --force mild,mottle=0.05
snaps shading-a 19041 --kind a --force mild,strength=4,shadows
snaps shading-b 19042 --kind b --force mild,strength=4,shadows
snaps exposure-a 19051 --kind a --force mild,exposure=2.2
snaps exposure-b 19052 --kind b --force mild,exposure=2.2
snaps wall 19061 --kind a --force mild,wall
snaps smaller-a 19071 --kind a --force mild,scale=0.75
snaps smaller-b 19072 --kind b --force mild,scale=0.75
snaps larger-a 19073 --kind a --force mild,scale=1.25
snaps larger-b 19074 --kind b --force mild,scale=1.25
snaps slots 19081 --kind b --force mild,slots=2
snaps hole 19082 --kind b --force mild,hole=1..2.5
snaps mild-a 19093 --kind a --force mild
snaps mild-b 19094 --kind b --force mild
snaps mini-a 19091 --kind a --force mild,frame=gelsight-mini
snaps mini-b 19092 --kind b --force mild,frame=gelsight-mini
snaps yaw 19101 --kind a --force cut=no
snaps cut 19102 --kind mixed --force mild,cut
snaps touching 19103 --kind mixed --force mild,touching
snaps side 19104 --kind a --force mild,side
snaps faint 19105 --kind mixed --force mild,depth=0.3..0.8
snaps smoothed 19106 --kind mixed --force mild,mechanics=smoothed

# No snap.
look_alike block 19201 block
look_alike tab 19202 tab
look_alike ring 19203 ring
look_alike nut 19204 nut
look_alike ball 19205 ball
look_alike screw 19206 screw
look_alike letters 19207 letters
look_alike arm 19208 arm
look_alike prism 19209 prism
look_alike bracket 19210 bracket
look_alike rib 19211 rib
look_alike edge 19212 edge
look_alike pin 19213 pin
look_alike bare 19214 nothing
look_alike clutter 19215 clutter

# Snaps in company, small ones, other barbs, gel that darkens with depth, light from one side.
snaps pairs-a 19301 --kind a --force gap=0.3..1.2
snaps pairs-b 19302 --kind b --force gap=0.3..1.2
snaps pairs 19303 --kind mixed --force gap=0..1.2
snaps small-a 19311 --kind a --force size=3.5..5
snaps small-b 19312 --kind b --force size=3.5..5
snaps barbs 19321 --kind a --force barbs
snaps dark-a 19331 --kind a --force darkness=0.4..0.9,strength=0.1..1,colour=-1..0.2
snaps dark-b 19332 --kind b --force darkness=0.4..0.9,strength=0.1..1,colour=-1..0.2
snaps light-right 19341 --kind mixed --force light=-20..20,shadows=0.5..1,strength=1..4
snaps light-below 19342 --kind mixed --force light=70..110,shadows=0.5..1,strength=1..4
snaps light-left 19343 --kind mixed --force light=160..180,shadows=0.5..1,strength=1..4
snaps light-above 19344 --kind mixed --force light=-110..-70,shadows=0.5..1,strength=1..4
snaps grey-a 19351 --kind a --force colour=-1
snaps barb-alone 19361 --kind a --force depth=0.1..0.3,side=no

# No snap: round things with bright and dark rims, fasteners of other kinds, things side by side.
rimmed() {
    set_of "$1" "$2" 50 --conditions wide --kind none --look-alike "$3" --force rim=-0.5..1
}
rimmed rim-ball 19401 ball
rimmed rim-dome 19402 dome
rimmed rim-button 19403 button
rimmed rim-rivet 19404 rivet
rimmed rim-torus 19405 torus
look_alike clip 19411 clip
look_alike fir-tree 19412 fir-tree
set_of company 19413 100 --conditions wide --kind none --force gap=0..1.2
