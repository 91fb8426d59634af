#include "action.h"

#include <string.h>

void action_map(
    const ActionConstants *constants, const double action[4], double cosine, double sine, double displacement[4],
    double unit[4])
{
    memset(displacement, 0, 4 * sizeof *displacement);
    memset(unit, 0, 4 * sizeof *unit);
    for (int k = 0; k < 4; k++) {
        const int column = (int)constants->column[k];
        const double cut = clip(action[k], -1.0, 1.0);
        unit[column] = cut;
        displacement[column] = (constants->squared[k] ? cut * fabs(cut) : cut) * constants->limit[k];
    }
    if (constants->in_tool_frame[0]) {
        const double x = displacement[0], y = displacement[1];
        displacement[0] = cosine * x - sine * y;
        displacement[1] = sine * x + cosine * y;
    }
}
