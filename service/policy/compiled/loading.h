/* Preparation of functions.c when the module is loaded. */
#ifndef LOADING_H
#define LOADING_H

/* Take numpy's functions. Return -1 with an exception if one is missing. */
int load_functions(PyObject *numpy);

#endif
