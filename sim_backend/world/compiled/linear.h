/* linear.py, and numpy's clip. */
#ifndef LINEAR_H
#define LINEAR_H

/* Product of a matrix (size, size) and a vector (size): the even columns, then the odd ones. */
static inline void product(const double *matrix, const double *vector, double *out, int size)
{
    for (int k = 0; k < size; k++) {
        const double *row = matrix + size * k;
        double even = row[0] * vector[0], odd = row[1] * vector[1];
        for (int column = 2; column < size; column += 2)
            even += row[column] * vector[column];
        for (int column = 3; column < size; column += 2)
            odd += row[column] * vector[column];
        out[k] = even + odd;
    }
}

/* Moment about the origin of a force at a point. */
static inline void moment(const double point[3], const double force[3], double out[3])
{
    out[0] = point[1] * force[2] - point[2] * force[1];
    out[1] = point[2] * force[0] - point[0] * force[2];
    out[2] = point[0] * force[1] - point[1] * force[0];
}

/* A number within ±bound; what is not a number stays. */
static inline double within(double number, double bound)
{
    return number < -bound ? -bound : number > bound ? bound : number;
}

#endif
