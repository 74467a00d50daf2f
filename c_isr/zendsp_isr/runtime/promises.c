/* promises.c: whether what a machine says of itself (machine_info) can be meant. A scale of 0, a
 * limit that is no number or a STOP input that does not exist would be found out by the machine.
 */
#include <math.h>   /* isfinite */
#include <stdio.h>  /* snprintf */
#include <string.h> /* strcmp */

#include "runner.h"

/* What is wrong with a joint, NULL where nothing is. Limits may be infinite: enabling then asks
 * for others. */
static const char *of_joint(const machine_joint *j) {
    const bool torque = strcmp(j->command, "torque") == 0 || strcmp(j->command, "force") == 0;
    if (!isfinite(j->counts_per_unit) || j->counts_per_unit == 0.0)
        return "counts_per_unit is 0 or no number: positions could not be told";
    if (!isfinite(j->zero_counts))
        return "zero_counts is no number";
    if (!(j->position_min < j->position_max))
        return "position_min is not below position_max, or one is no number";
    if (!(j->speed_max > 0.0))
        return "speed_max is not above 0: give what the joint bears";
    if (!(j->torque_max >= 0.0))
        return "torque_max is below 0 or no number";
    if (!(j->command_max >= 0.0))
        return "command_max is below 0 or no number";
    if (!isfinite(j->mv_per_torque) || (torque && j->mv_per_torque == 0.0))
        return "mv_per_torque is no number, or 0 while its command is a torque";
    return isfinite(j->mv_per_speed) ? NULL : "mv_per_speed is no number";
}

int promises_check(const machine_info *info, char *why, size_t size) {
    if (info->joints < 1 || info->joints > MACHINE_JOINTS || info->adcs < 0 ||
        info->adcs > MACHINE_ADCS)
        return snprintf(why, size, "machine_info: 1 to %d joints and 0 to %d adcs are possible,"
                        " not %d and %d", MACHINE_JOINTS, MACHINE_ADCS, info->joints, info->adcs);
    if (info->dins < 0 || info->dins > 32 || info->douts < 0 || info->douts > 32)
        return snprintf(why, size, "machine_info: %d dins and %d douts: 0 to 32 are possible",
                        info->dins, info->douts);
    if (info->stop_input < -1 || info->stop_input >= info->dins)
        return snprintf(why, size,
                        "machine_info: stop_input %d is none of its %d digital inputs (dins), so"
                        " that it could not stop: count them from 0, -1 is none",
                        info->stop_input, info->dins);
    if (info->stop_level != 0 && info->stop_level != 1)
        return snprintf(why, size, "machine_info: stop_level is 0 or 1, not %d",
                        info->stop_level);
    for (int j = 0; j < info->joints; j++) {
        const char *wrong = of_joint(&info->joint[j]);
        if (wrong)
            return snprintf(why, size, "machine_info: joint[%d] (%.31s): %s", j,
                            info->joint[j].name, wrong);
    }
    return 0;
}
