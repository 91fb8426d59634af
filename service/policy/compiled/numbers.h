/* Arithmetic of numpy on single numbers, and fields from which both sides take names, sizes and order. */
#ifndef NUMBERS_H
#define NUMBERS_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

static const double PI = 3.141592653589793;

/* `np.maximum` and `np.minimum`: not a number where either is not. */
static inline double maximum(double a, double b) { return isnan(a) || a > b ? a : b; }
static inline double minimum(double a, double b) { return isnan(a) || a < b ? a : b; }

/* `np.clip` */
static inline double clip(double number, double lower, double upper)
{
    return minimum(maximum(number, lower), upper);
}

/* `pose.wrap`; `np.remainder` by 2π has the sign of 2π */
static inline double wrap(double angle)
{
    double rest = fmod(angle + PI, 2 * PI);
    if (rest < 0)
        rest += 2 * PI;
    return rest - PI;
}

/* `np.sqrt((v * v).sum(-1))` */
static inline double length3(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

typedef enum { TRUTH, INTEGER, SINGLE, NUMBER } Kind;

/* A field of a structure, or an array with one row of it per cell: name, kind, numbers in a row, place. */
typedef struct {
    const char *name;
    Kind kind;
    ptrdiff_t size;
    size_t place;
} Field;

#define NUMBER_MEMBER(name, size) double name[size];
#define INTEGER_MEMBER(name, size) int32_t name[size];
#define TRUTH_MEMBER(name, size) unsigned char name[size];
#define MEMBER(name, kind, size) kind##_MEMBER(name, size)
#define CONSTANT_MEMBER(name, size) double name[size];

#endif
