#!/usr/bin/env bash
# A session in tmux, to watch: build, enable, run, tune, record, stop. Needs tmux and zendsp on the
# PATH.
#     docs/screens/session.sh [columns] [rows]
# With SESSION_PRINT=1 it prints the screen after each step in place of showing it (no terminal
# needed).
set -euo pipefail
columns=${1:-140} rows=${2:-42}
socket=zendsp-session-$$
folder=$(mktemp -d)
trap 'tmux -L "$socket" kill-server 2>/dev/null || true; rm -rf "$folder"' EXIT
source=$(python3 -c 'from importlib import resources; print(resources.files("zendsp_isr") / "programs" / "pd.c")')
tmux -L "$socket" new-session -d -x "$columns" -y "$rows" "zendsp tui --local imi_planar --folder '$folder' --source '$source'"

screen() { tmux -L "$socket" capture-pane -p; }
until_seen() { # words, at most 60 s
    for _ in $(seq 600); do
        if screen | grep -q -- "$1"; then return 0; fi
        sleep 0.1
    done
    echo "did not appear: $1" >&2
    screen >&2
    exit 1
}
step() { # title, words to wait for, keys …
    local title=$1 words=$2
    shift 2
    for key in "$@"; do
        tmux -L "$socket" send-keys "$key"
        sleep 0.4
    done
    until_seen "$words"
    if [ -n "${SESSION_PRINT:-}" ]; then
        printf '\n=== %s\n' "$title"
        screen
    fi
}
play() {
    step "The simulated arm answers" "imi_planar-"
    step "b: compile and download pd.c" "Kp1" b
    step "o, e: power and enable" "enabled, torque" o e
    step "s: the arm draws circles" "running" s
    sleep 5
    step "t: stage Kp1 = 500" "staged" t 5 0 0 Enter
    step "u: review" "takes effect" u
    step "Enter: applied in one sample" "applied at sample" Enter
    step "x: cursors" "Δt" x
    step "r: record two seconds" "Duration" r
    step "Enter: recorded" "0 lost, kept" Enter
    step "F3: the run is in the list" "recording" F3
    step "F4: plan a motion" "within every limit" F4
    step "F9: STOP, from here" "stopped" F9
    step "Ctrl+K: acknowledged" "homed" C-k
    sleep 2
    tmux -L "$socket" send-keys C-q
}
if [ -n "${SESSION_PRINT:-}" ]; then
    play
else
    play &
    tmux -L "$socket" attach
    wait
fi
