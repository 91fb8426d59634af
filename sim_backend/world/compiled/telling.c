#include "telling.h"

#include <string.h>

#include "linear.h"
#include "quaternion.h"

static void copy(Rows to, Rows from, intptr_t cell, size_t count)
{
    memcpy(numbers(to, cell), numbers(from, cell), count * sizeof(double));
}

void telling_fill(const Telling *telling, const Report *report, intptr_t n)
{
    static const double identity[4] = {1.0, 0.0, 0.0, 0.0};
    for (intptr_t cell = 0; cell < n; cell++) {
        copy(report->q, telling->joints, cell, 6);
        copy(report->qd, telling->qvel, cell, 6);
        copy(report->tcp_position, telling->position, cell, 3);
        rotvec_of(numbers(telling->rotation, cell), numbers(report->tcp_rotvec, cell));
        product(numbers(telling->jacobian, cell), numbers(telling->qvel, cell), numbers(report->tcp_velocity, cell), 6);
        copy(report->target_position, telling->target_position, cell, 3);
        rotation_between(identity, numbers(telling->target_quaternion, cell), numbers(report->target_rotvec, cell));
        copy(report->wrench, telling->wrench, cell, 6);
        copy(report->ft_raw, telling->raw, cell, 6);
        copy(report->hole_estimate, telling->estimate, cell, 3);
        copy(report->peak_force, telling->peak_force, cell, 1);
    }
}
