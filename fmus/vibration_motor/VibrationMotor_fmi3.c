/* The FMI 3.0 FMU in one translation unit: all that it shows to a linker are the functions of the
 * standard, with the model's name before theirs. A shared library has them under their plain
 * names: define FMI3_OVERRIDE_FUNCTION_PREFIX for it. */
#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX VibrationMotor_
#endif
#include "fmi3Functions.h"

#include "instance.c"
#include "motor_instance.c"
#include "derivatives.c"

#include "plain.c"

#include "fmi3.c"
#include "fmi3_motor.c"
