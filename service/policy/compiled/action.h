/* action.py: from the policy's output to a displacement. */
#ifndef ACTION_H
#define ACTION_H

#include "numbers.h"

/* Per output of the network: place in dx, dy, dz, dyaw; limit; whether the map is a·|a|. One for all: tool axes. */
#define ACTION_CONSTANTS(X) \
    X(column, 4) \
    X(limit, 4) \
    X(squared, 4) \
    X(in_tool_frame, 1)

typedef struct {
    ACTION_CONSTANTS(CONSTANT_MEMBER)
} ActionConstants;

/* `ActionMap.displacement` and `ActionMap.unit`, with cosine and sine of the measured yaw. */
void action_map(
    const ActionConstants *constants, const double action[4], double cosine, double sine, double displacement[4],
    double unit[4]);

#endif
