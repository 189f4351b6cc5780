# An old program's whole life against a daemon that serves a mac23 at ./mac23, and a mac23-can on a bus
# with an slcan adapter at ./mac23-can: all that a person would do at the machine is done by axistwin ctl.
# $AXISTWIN_CONTROL says where.  Ends at the first surprise.
set -eu

say() { axistwin send ./mac23 "$@"; }
say_can() { axistwin send slcan:./mac23-can "$@"; }
hand() { axistwin ctl mac23 "$@"; }
wants() { # WANTED WHAT...: the last line of what it says has WANTED
    wanted=$1; shift
    got=$("$@" | tail -1)
    case $got in *"$wanted"*) ;; *) echo "wanted '$wanted' of '$*', got '$got'"; exit 1 ;; esac
}
until_is() { # CONTROL VALUE: wait for it
    for _ in $(seq 200); do [ "$(hand "$1")" = "$2" ] && return; done
    echo "$1 did not become $2: $(hand "$1")"; exit 1
}

echo home
wants accepted say 'motor on' 'reference on' 'go to -20000'
until_is position -20000
wants accepted say 'velocity +, period 20000' # slowly now
hand inputs.reference on # it is met
hand inputs.reference off # and left: the counter is 0 here
wants accepted say 'velocity 0'
until_is is_moving off
[ "$(hand position)" -gt 0 ]
wants accepted say 'reference off' 'go to 0'
until_is is_moving off
wants 'position = 0 ' say 'position?'

echo limit
wants accepted say 'motor off' 'hardware stops' 'motor on' 'go to 30000'
hand inputs.positive_stop on
until_is is_moving off
[ "$(hand position)" -lt 30000 ]
wants accepted say 'go to 0' # away from it
until_is position 0
hand inputs.positive_stop off

echo fault
hand faults.micro_cut on
wants 'status = 01 ' say 'status?'
wants refused say 'go to 100'
hand faults.micro_cut off
wants refused say 'go to 100' # it is remembered
say 'initialise' 'wait 2200 ms' > answers
wants 'status = 00 ' say 'status?'
wants accepted say 'motor on' 'go to 100'
until_is position 100

echo supply
wants accepted say 'maximum speed, period 20000' 'go to 30000'
hand power off
kept=$(hand position)
[ "$kept" -lt 30000 ]
hand power on
until_is state 'at rest, unpowered'
wants "position = $kept " say 'position?'
wants accepted say 'motor on' 'go to 0'

echo emergency
wants accepted say_can 'motor on'
axistwin ctl mac23-can faults.micro_cut on # nobody acknowledges the message until the program is back
say_can 'wait 3000 ms' > answers # a busy machine is slow; after 10 s a lifebeat repeats it
wants 'emergency 3100h, status 01 00 00 00 ' grep emergency answers # before the pause begins, or in it
[ "$(grep -c emergency answers)" -eq 1 ] # it came once
wants refused say_can 'go to 100'
axistwin ctl mac23-can faults.micro_cut off
wants boot-up say_can 'initialise' 'wait 2200 ms'
wants accepted say_can 'motor on' 'go to 100'
echo alive
