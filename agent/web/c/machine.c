/* What kernels call that is not theirs: the motors' FMU, and memory for small arrays. */
#include "VibrationMotors_fmi3.c"

#define EXPORTED(name) __attribute__((export_name(#name)))

/* The calls that kernels make have sizes of 64 bits. */
static int set_float64(void *motors, const uint32_t references[], int64_t count,
                       const double values[], int64_t value_count) {
    return fmi3SetFloat64(motors, references, (size_t)count, values, (size_t)value_count);
}

static int get_float64(void *motors, const uint32_t references[], int64_t count, double values[],
                       int64_t value_count) {
    return fmi3GetFloat64(motors, references, (size_t)count, values, (size_t)value_count);
}

/* Addresses of functions in the order of `cosim.fmi.calls.Addresses`. */
EXPORTED(address_of) int address_of(int k) {
    return k == 0 ? (int)set_float64 : k == 1 ? (int)fmi3DoStep : (int)get_float64;
}

EXPORTED(room) void *room(size_t size) { return aligned_alloc(64, (size + 63) / 64 * 64); }

/* The motors in a state that the FMU has saved on any machine; NULL if it is none. */
EXPORTED(restore_motors) void *restore_motors(const uint8_t state[], size_t size) {
    static void *motors;
    void *saved = NULL;
    if (!motors)
        motors = fmi3InstantiateCoSimulation("motors", INSTANTIATION_TOKEN, NULL, false, false,
                                             false, false, NULL, 0, NULL, NULL, NULL);
    if (!motors || fmi3DeserializeFMUState(motors, state, size, &saved) != fmi3OK)
        return NULL;
    const fmi3Status status = fmi3SetFMUState(motors, saved);
    fmi3FreeFMUState(motors, &saved);
    return status == fmi3OK ? motors : NULL;
}

/* Arrays of numba's runtime, with the sizes of the machine that it compiles for. */
typedef struct {
    int64_t references;
    void *release, *about, *data;
    int64_t size;
    void *allocator;
} Array;

void *NRT_Allocate(int64_t size) { return malloc((size_t)size); }

void NRT_Free(void *memory) { free(memory); }

void *NRT_MemInfo_alloc_aligned(int64_t size, int32_t alignment) {
    (void)alignment; /* at most 64 */
    Array *array = aligned_alloc(64, ((size_t)size + 127) / 64 * 64);
    *array = (Array){.references = 1, .data = (char *)array + 64, .size = size};
    return array;
}

void *NRT_MemInfo_alloc(int64_t size) { return NRT_MemInfo_alloc_aligned(size, 16); }

/* The data of lists, which grow, stand apart. */
void *NRT_MemInfo_new_varsize_dtor(int64_t size, void *release) {
    (void)release; /* of elements, which are numbers */
    Array *list = malloc(sizeof *list);
    *list = (Array){.references = 1, .data = malloc((size_t)size), .size = size};
    return list;
}

void *NRT_MemInfo_varsize_realloc(Array *list, int64_t size) {
    list->size = size;
    return list->data = realloc(list->data, (size_t)size);
}

void NRT_MemInfo_call_dtor(Array *array) {
    if (array->data != (char *)array + 64)
        free(array->data);
    free(array);
}

/* What numba's errors would say to Python. */
void *PyExc_RuntimeError;

void PyErr_SetString(void *kind, const char *text) {
    (void)kind, (void)text;
    __builtin_trap();
}
