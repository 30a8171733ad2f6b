/* The FMI 3.0 FMU of an array of motors in one translation unit: all that it shows to a linker are the
 * functions of the standard, with the model's name before theirs. A shared library has them under
 * their plain names: define FMI3_OVERRIDE_FUNCTION_PREFIX for it. */
#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX VibrationMotors_
#endif
#include "array.c"

#include "array_access.c"
#include "array_saving.c"

#include "fmi3.c"
#include "fmi3_array.c"
