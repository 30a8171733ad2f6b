/* What is alike for models whose variables have one number each and whose state is plain data
 * (plain.c): access to variables by value reference, saved and serialised states. A copy of a `Plain`
 * is all that such a model is. The model defines that type before it includes this file, with inputs
 * `in.value`, parameters `p.value` (among them p.step_size) and no padding. */
#ifndef PLAIN_H
#define PLAIN_H

#include "instance.h"
#include "variables.h"

typedef struct {
    Instance base;
    Plain plain;
} PlainInstance;

static inline Plain *plain_of(Instance *instance) { return &((PlainInstance *)instance)->plain; }

static inline const Plain *plain_in(const Instance *instance) {
    return &((const PlainInstance *)instance)->plain;
}

/* A variable that is not floating-point: an int32_t somewhere in a Plain. */
typedef struct {
    uint32_t reference;
    const char *type; /* "Boolean" or "Enumeration" */
    size_t place;
    int32_t least, most;
} Option;

/* What the model supplies. */

/* Read an output or a local variable; false if there is none of that reference. */
static inline bool plain_read(const Instance *instance, uint32_t reference, double *value);
/* Put inputs, and unless those alone were set parameters too, into force. */
static inline void plain_changed(Instance *instance, bool only_inputs);
/* Put a state from outside into force. */
static inline void plain_derive(Plain *plain);
/* Whether the model could be in that state, where inputs, parameters and options are in range. */
static bool plain_is_sound(const Plain *plain, const Standing *now);

#endif
