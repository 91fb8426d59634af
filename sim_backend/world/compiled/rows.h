/* Arrays of numpy with one row per cell, and lists from which both sides take names, sizes and order. */
#ifndef ROWS_H
#define ROWS_H

#include <stdint.h>

/* The `size` numbers of a row stand side by side; rows need not, since some arrays are views into MuJoCo's data. */
typedef struct {
    char *data;
    intptr_t stride, size;
} Rows;

static inline double *numbers(Rows rows, intptr_t cell) { return (double *)(rows.data + cell * rows.stride); }
static inline float *singles(Rows rows, intptr_t cell) { return (float *)(rows.data + cell * rows.stride); }
static inline int64_t *integer(Rows rows, intptr_t cell) { return (int64_t *)(rows.data + cell * rows.stride); }
static inline unsigned char *truth(Rows rows, intptr_t cell) { return (unsigned char *)(rows.data + cell * rows.stride); }

/* `number % size` of numpy and Python: within the size for negative numbers, too. */
static inline int64_t around(int64_t number, int64_t size)
{
    const int64_t rest = number % size;
    return rest < 0 ? rest + size : rest;
}

typedef enum { TRUTH, INTEGER, SINGLE, NUMBER } Kind;
typedef enum { READ, WRITTEN } Access;

#define AT_LEAST(size) (-(size))

/* An array: name, kind, numbers in a row, access. */
typedef struct {
    const char *name;
    Kind kind;
    intptr_t size;
    Access access;
} Field;

/* A constant: name and size, all of double precision. */
typedef struct {
    const char *name;
    intptr_t size;
} Constant;

#define AS_ROWS(name, kind, size, access) Rows name;
#define AS_FIELD(name, kind, size, access) {#name, kind, size, access},
#define AS_NUMBER(name) double name;
#define AS_VECTOR(name, size) double name[size];
#define AS_CONSTANT(name) {#name, 1},
#define AS_CONSTANTS(name, size) {#name, size},

#endif
