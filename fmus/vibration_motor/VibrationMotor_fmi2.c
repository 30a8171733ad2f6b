/* The FMI 2.0 FMU in one translation unit: all that it shows to a linker are the functions of the
 * standard, with the model's name before theirs. A shared library has them under their plain
 * names: define FMI2_OVERRIDE_FUNCTION_PREFIX for it, which headers before 2.0.4 do not know. */
#if !defined(FMI2_FUNCTION_PREFIX) && !defined(FMI2_OVERRIDE_FUNCTION_PREFIX)
#define FMI2_FUNCTION_PREFIX VibrationMotor_
#endif
#include "single.c"

#include "fmi2.c"
