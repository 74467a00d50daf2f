"""The numbers that decide what is claimed, and with it how many false alarms there are; each with
what it means.

The measurements behind them: docs/measurements/diagnosis_choices.md.
"""

from __future__ import annotations

# of what is claimed, at most so much is nothing: e-values, over joints and mechanisms
FALSE_DISCOVERIES = 0.05
LAW_ERROR = 0.03  # no law describes its own mechanism better than to so much of its size
# of a mechanism's size, as a function of its own variables: a law of one number that leaves more is
# none
LEFT_BY_A_LAW = 0.2
# of the RMS torque: where two simulators differ by so much, it is no lack of a law
SIMULATORS_DIFFER = 0.001
FINEST = 0.0003  # of the RMS torque: what is less is never a finding, however likely
# the same, of what comes late or swings: so does a simulator that takes other steps. A complete arm
# had a spring of 0.0018; the smallest of 31 right ones was 0.0056
STEPPED = 0.0025
# of a mechanism's size: without it, so much lacks at most, and no less. Of 140 right claims (seed
# 211, and another maker's cases) 0.7 was the least, of the false spring of a complete arm 0
LACKED = 0.5
OWN_SHARE = 0.1  # of the explainable mismatch: a second law of one mechanism below is a refinement
MACHINE = 0.03  # of the RMS torque: below, slow random torques that every machine has
# times the sensor's own error: a position that is off by more lacks torque, however uncertain; of
# ten complete models whose torque said 3 % and more (seeds 97 to 113) seven were at most 1.1, three
# 4.4 and more
BEYOND_SENSOR = 3.0
# the same, times the part of the torque that lacks: at 51 complete models of three makers 0.052 at
# most (0.03 with a random torque of 0.6 %); with dropped commands, a sagging supply or a loose mass
# 0.08
THROWN = 0.06
# as MACHINE, in the recordings to choose by alone: there a push of a second is as uncertain as
# it is large; at 253 joints of 206 complete models (seeds 103, 107) 0.054 was the most. And what a
# test recording has to exclude before a position that is BEYOND_SENSOR is complete
AMISS = 0.1
# of the RMS torque: a mechanism whose removal costs more than there is has run away on recordings
# that it was not fitted to: a gap fitted at 24 counts cost 36 times the floor
RUN_AWAY = 1.0
# of the RMS torque: more lacks where the model itself runs away (7 000, behind a spring whose load
# was heavier than the joint); pushes of an acrobot's free joint were 25 at most
ASTRAY = 100.0
# of the RMS torque: a function of state above is missing physics, whatever its name; in 96 complete
# models it was at most 0.001
OF_STATE = 0.0025
# the same, of what comes and goes, follows from the motion before, or repeats itself; at most
# 0.008. And of what surely lacks where the position is BEYOND_SENSOR: at six such complete models
# of other makers it was 0.003 at most, of a foreign torque 0.023
LAWFUL = 0.01
# the same, of a push that is told and is no finding: a hand that held a table had 0.0012, and 49
# complete machines of two examiners no such thing from 0.0005 on
FELT = 0.0005
TIED = 0.05  # probability above which a law is still in the race
BOOTSTRAP_DRAWS = 400  # of the Bayesian bootstrap
STATED_LAW = 0.001  # probability: a less likely law is not listed
EXPLAINS = 0.1  # of a gain: a rival that reaches less does not explain the mismatch
# of a gain: a rival that falls behind by less, with the same torque, is not told apart
INSEPARABLE = 0.5
HANGING = 0.2  # sine of a gravity term's angle: nearer to 0 or pi it is a payload's weight
SURE = 3.0  # standard deviations over blocks of time
# the same, over shifts in time, of which there are few: of 32 foreign torques that depend on the
# state 7 and more; of 206 complete models 0.05 % was the largest such function
BY_CHANCE = 5.0
CLAIMED = 2.5  # the same, of a claim, beside its e-value; right ones had 2.8 and more
PLAIN = 2.0  # the same, of what has another measure beside it
# of a lacking torque's energy: a mechanism whose variables predict less is not claimed
PREDICTED = 0.5
RIVAL = 0.5  # of that again: where another mechanism's variables predict so much, neither is
# of the size of a mechanism without a law: what is not larger beside it may be a part of it;
# chosen on one case
A_PART = 0.5
# standard deviations by which a law's neighbour predicts better, where the law is none
# (docs/measurements/diagnosis_choices.md)
BEHIND = 1.5
# of a wave's order and amplitude: another that differs by less is its twin. Two ripples of a torque
# constant were such pairs, 0.7 and 0.1 % apart
TWINS = 0.05
# of what lacks, that a function of the command predicts where the actuator is to blame: in a loop
# the command follows whatever the joint bears. Errors of an actuator came to 0.92 to 1.0, a
# Maxwell element and a friction of the load to 0.57 and 0.74
COMMANDED = 0.9
# times what the given model has, beside another law of the same friction. Beside 13 right laws
# viscous friction came out at 0.5 to 1.3 times its given number, beside two drags that stood for
# |v|^1.5 at 3.2 and 5.5 times; and where calibration drove dry friction to nothing, at 10 for
# |v|^1.6 (one case)
GROWN = 2.0
CURVE = 3  # so many laws of one mechanism at one joint draw a curve
HARMONIC = 0.05  # of a whole number: a ripple's order over the lowest
# A function of the state beside which something stays unexplained can be another one: its law,
# where it is not what every machine has, is stated where it is more likely than this. Of 138 right
# laws on four makers' cases 4 were less likely, of 12 wrong ones 5; on fresh cases two thirds would
# have stated two more wrong ones, and one right one.
STATED_BESIDE = 0.7
# The same of any other law, or where nothing is left that could speak against it.
STATED_ALONE = 1 / 3

# Relative standard deviation of a given inertia, mass or gravity; more where its std says so.
TOLERANCE = 0.045
