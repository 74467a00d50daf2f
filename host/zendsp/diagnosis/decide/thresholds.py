"""The numbers that decide what is claimed, and so the rate of false alarms; each with its meaning.

The measurements behind them: docs/measurements/diagnosis_choices.md.
"""

from __future__ import annotations

from zendsp.diagnosis.search.body_hypotheses import LIMITS

# share of the claims that may be false: e-values over all joints and mechanisms
FALSE_DISCOVERIES = 0.05
LAW_ERROR = 0.03  # of its size: no law describes its mechanism better
# of a mechanism's size: torque over its own variables. A law with one number that leaves more is
# not the law
LEFT_BY_A_LAW = 0.2
# of the RMS torque: the difference of two simulators, which speaks against no law
SIMULATORS_DIFFER = 0.001
FINEST = 0.0003  # of the RMS torque: a smaller effect is never a finding, however likely
# the same beside bodies of a file, which are held: masses with three digits are off by up to 0.0005
FINEST_BESIDE_BODIES = 0.001
# the same for delays, lags and springs, which a simulator with another step size imitates. A
# complete arm had a spring of 0.0018; the smallest of 31 right ones was 0.0056
STEPPED = 0.0025
# of a mechanism's size: the least torque that has to be missing without it. The least of 140 right
# claims (seed 211, and another maker's cases) was 0.7; the false spring of a complete arm had 0
LACKED = 0.5
OWN_SHARE = 0.1  # of the explainable mismatch: a second law of one mechanism below is a refinement
MACHINE = 0.03  # of the RMS torque: smaller ones are slow random torques, which every machine has
# times the sensor's own error: a larger position error means missing torque, however uncertain the
# torque is. Of ten complete models with 3 % and more (seeds 97 to 113) seven had at most 1.1, three
# 4.4 and more
BEYOND_SENSOR = 3.0
# the same times the missing part of the torque: at most 0.052 in 51 complete models of three makers
# (0.03 with a random torque of 0.6 %); 0.08 with dropped commands, a sagging supply or a loose mass
THROWN = 0.06
# as MACHINE, in the recordings to choose by alone, where a push of one second is as uncertain as it
# is large: at most 0.054 at 253 joints of 206 complete models (seeds 103, 107). Also the torque
# that a test recording has to exclude before a position error BEYOND_SENSOR is called complete
AMISS = 0.1
# of the RMS torque: a mechanism whose removal costs more has diverged on recordings that it was not
# fitted to, as a gap fitted at 24 counts, which cost 36 times the floor
RUN_AWAY = 1.0
# of the RMS torque: more is missing only where the model itself diverges (7 000, with a spring
# whose load was heavier than the joint); pushes of an acrobot's free joint had 25 at most
ASTRAY = 100.0
# of the RMS torque: a larger function of the state is missing physics, with or without a name; at
# most 0.001 in 96 complete models
OF_STATE = 0.0025
# the same for a torque that comes and goes, follows from earlier motion, or repeats; there at most
# 0.008. Also for what is surely missing, whatever the position's error: at most 0.006 in 186
# complete models of three makers (seeds 331, 502), 0.019 with two foreign torques
LAWFUL = 0.01
# the same for a push that is noted and no finding: a hand that held a table had 0.0012; 49 complete
# machines of two examiners had none above 0.0005
FELT = 0.0005
TIED = 0.05  # probability above which a law is still in the race
BOOTSTRAP_DRAWS = 400  # of the Bayesian bootstrap
STATED_LAW = 0.001  # probability below which a law is not listed
EXPLAINS = 0.1  # of a gain: a rival with less does not explain the mismatch
# of a gain: a rival with the same torque that falls behind by less cannot be told apart
INSEPARABLE = 0.5
HANGING = 0.2  # sine of a gravity term's angle: nearer to 0 or pi it is a payload's weight
SURE = 3.0  # standard deviations over blocks of time
# the same over shifts in time, of which there are few: 32 foreign torques over the state had 7 and
# more; in 206 complete models 0.05 % was the largest such function
BY_CHANCE = 5.0
CLAIMED = 2.5  # the same for a claim, beside its e-value; right ones had 2.8 and more
PLAIN = 2.0  # the same where another measure must hold too
# of the missing torque's energy: a mechanism whose variables predict less is not claimed
PREDICTED = 0.5
# of a push's energy, at places where the joint was at other times too: with less it may be
# something that the joint touches there. Eleven pushes had 0.99 and more; of touches, which had
# 0.005 to 0.77, other visits predicted 0.8 and more, and 0.13 at most of a push
VISITED = 0.5
RIVAL = 0.5  # of that: where another mechanism's variables predict as much, neither is claimed
# of the size of a mechanism without a law: a smaller claim beside it may be a part of it; chosen on
# one case
A_PART = 0.5
# of a stiffness, a standard deviation beside that of the fit where another joint of an arm has a
# spring, too: eight of four arms were off by -1.9 to 2.1 %, 1.2 % RMS
SPRINGS_SHIFT = 0.012
# of a wave's order and amplitude: a wave that differs by less is its twin. Two ripples of a torque
# constant gave such pairs, 0.7 and 0.1 % apart
TWINS = 0.05
# of the missing torque that a function of the command must predict to blame the actuator, since in
# a loop the command follows whatever the joint bears. Errors of an actuator had 0.92 to 1.0, a
# Maxwell element and a friction of the load 0.57 and 0.74
COMMANDED = 0.9
# The Coulomb friction to which a Stribeck curve falls, over what the curve has more at standstill:
# with less it is merely some curve over the speed. Right curves had 0.70 and 1.07 (seed 1003), a
# sine of the speed 0.14 (seed 902)
BASE_LEFT = 0.25
# of the squares of a torque over the position beside a claimed body: where bodies can draw more it
# may be the error of its weight. Of a ripple of eight waves a turn they drew 0.24
DRAWN = 0.5
# times the given number, for friction beside another law of the same kind. Beside 13 right laws
# viscous friction came out at 0.5 to 1.3 times its given number; beside two drags that imitated
# |v|^1.5 at 3.2 and 5.5 times; where calibration drove dry friction to zero, at 10 for |v|^1.6 (one
# case)
GROWN = 2.0
# probability that a friction without a law is dry where it needs a step at standstill: of 4 on
# fresh cases (seed 801 and an examiner) 2 were, and 2 rose as steeply, |v|^0.6 and a brake by eddy
# currents
STEEP = 0.6
# the same that it is fluid where it needs none: 7 of 9 were (seeds 801, 902 and two examiners), and
# 2 were dry ones that set in as softly as tanh(v / 0.1)
SOFT = 0.75
CURVE = 3  # so many laws of one mechanism at one joint imitate a curve
HARMONIC = 0.05  # distance from a whole number of a ripple's order over the lowest order
# A function of the state may be another one where something stays unexplained. So its law (except
# laws that every machine has) is stated only with more confidence than this. On four makers' cases
# 4 of 138 right laws had less, and 5 of 12 wrong ones; on fresh cases a limit of two thirds would
# have stated two more wrong ones and one right one.
STATED_BESIDE = 0.7
# The same for any other law, or where nothing is left that could speak against it: likelier right
# than not. Between a third and a half seeds 801 and 1003 had four laws of their own and of foreign
# torques, all wrong.
STATED_ALONE = 0.5
# Highest probability of a law that leaves too much in its own variables, and lowest of one on whose
# number its recordings agree only roughly.
UNLIKELY = 1 / 3

# Relative standard deviation of a given inertia, mass or gravity; more where its std says so.
TOLERANCE = LIMITS.stated
# Times TOLERANCE: the model's own dry friction is surely not as stated with a number so far off. A
# hysteresis of 11 % of the torque moved Coulomb friction by 47 %, one of 3 % by 7 %.
OTHER_NUMBERS = 3.0
