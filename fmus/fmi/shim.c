/* What the shims of FMI 2.0 and 3.0 have alike. A shim defines before: FMI(name), the standard's
 * name of a function or type; STATE(before, after), that of a function of saved states, and
 * DESERIALIZE; VALUE_COUNT, a parameter nValues after an array of values or nothing; and
 * REQUIRE_VALUES, which refuses arrays of references and values that do not go together. */

FMI(Status)
FMI(SetDebugLogging)(void *instance, FMI(Boolean) loggingOn, size_t count,
                     const FMI(String) categories[]) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    return (FMI(Status))instance_set_logging(self, __func__, loggingOn != 0, count, categories);
}

void FMI(FreeInstance)(void *instance) { instance_free(instance); }

FMI(Status) FMI(ExitInitializationMode)(void *instance) {
    Instance *self = instance;
    REQUIRE(self, INITIALIZATION);
    if (check_changed(self, __func__) != STATUS_OK)
        return FMI(Error);
    self->now.life_cycle = STEP;
    return FMI(OK);
}

FMI(Status) FMI(Terminate)(void *instance) {
    Instance *self = instance;
    REQUIRE(self, STEP);
    self->now.life_cycle = TERMINATED;
    return FMI(OK);
}

FMI(Status) FMI(Reset)(void *instance) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    return (FMI(Status))instance_reset(self, __func__);
}

FMI(Status) STATE(Get, )(void *instance, void **state) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, state);
    return (FMI(Status))model_save(self, __func__, state);
}

FMI(Status) STATE(Set, )(void *instance, void *state) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, state);
    return (FMI(Status))model_restore(self, __func__, state);
}

FMI(Status) STATE(Free, )(void *instance, void **state) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    if (state) {
        free(*state);
        *state = NULL;
    }
    return FMI(OK);
}

FMI(Status) STATE(Serialized, Size)(void *instance, void *state, size_t *size) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, state);
    REQUIRE_POINTER(self, size);
    *size = sealed_size(model_state_size(state));
    return FMI(OK);
}

FMI(Status) STATE(Serialize, )(void *instance, void *state, FMI(Byte) bytes[], size_t size) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, state);
    REQUIRE_POINTER(self, bytes);
    const size_t content_size = model_state_size(state);
    return (FMI(Status))seal(self, __func__, state, content_size, (unsigned char *)bytes, size);
}

FMI(Status) DESERIALIZE(void *instance, const FMI(Byte) bytes[], size_t size, void **state) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, bytes);
    REQUIRE_POINTER(self, state);
    return (FMI(Status))model_deserialize(self, __func__, (const unsigned char *)bytes, size,
                                          state);
}

/* Access to variables that a model has as options, see instance.h, one by one. */
#define OPTION_ACCESS(Type, name)                                                                  \
    FMI(Status)                                                                                    \
    FMI(Get##Type)(void *instance, const FMI(ValueReference) references[], size_t count,           \
                   FMI(Type) values[] VALUE_COUNT) {                                               \
        Instance *self = instance;                                                                 \
        REQUIRE(self, READABLE);                                                                   \
        REQUIRE_VALUES(self, references, count, values);                                           \
        for (size_t k = 0; k < count; k++) {                                                       \
            const Option option = model_option(self, references[k], name);                         \
            if (!option.value)                                                                     \
                return (FMI(Status))fail_reference(self, __func__, references[k], name);           \
            values[k] = (FMI(Type)) * option.value;                                                \
        }                                                                                          \
        return FMI(OK);                                                                            \
    }                                                                                              \
    FMI(Status)                                                                                    \
    FMI(Set##Type)(void *instance, const FMI(ValueReference) references[], size_t count,           \
                   const FMI(Type) values[] VALUE_COUNT) {                                         \
        Instance *self = instance;                                                                 \
        REQUIRE(self, WRITABLE);                                                                   \
        REQUIRE_VALUES(self, references, count, values);                                           \
        for (size_t k = 0; k < count; k++)                                                         \
            if (check_option(self, __func__, references[k], name, values[k]) != STATUS_OK)         \
                return FMI(Error);                                                                 \
        for (size_t k = 0; k < count; k++)                                                         \
            *model_option(self, references[k], name).value = (int32_t)values[k];                   \
        model_options_changed(self);                                                               \
        return FMI(OK);                                                                            \
    }

/* What the model description does not offer. */
#define NOT_OFFERED(name, ...)                                                                     \
    FMI(Status) FMI(name)(void *instance, ##__VA_ARGS__) {                                         \
        Instance *self = instance;                                                                 \
        if (!self)                                                                                 \
            return FMI(Error);                                                                     \
        return (FMI(Status))fail(self, __func__, "this FMU does not offer it");                    \
    }
