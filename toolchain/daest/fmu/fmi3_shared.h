/* What all FMUs of daest share of FMI 3.0: saved states, and functions that they have no use for. It is included where
 * State is known, with
 *   state_of(instance)            the State of an instance
 *   state_was_set(instance)       called after a state was restored
 *   refuse(instance, name, why)   an error message; returns fmi3Error
 */
static fmi3Status not_supported(fmi3Instance instance, const char *name) {
    return refuse(instance, name, "not supported by this FMU");
}

/* -------------------------------------------------------------------------------------- saved FMU states */

FMI3_Export fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *saved) {
    if (!*saved) *saved = malloc(sizeof(State));
    if (!*saved) return refuse(instance, "fmi3GetFMUState", "out of memory");
    memcpy(*saved, state_of(instance), sizeof(State));
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState saved) {
    memcpy(state_of(instance), saved, sizeof(State));
    state_was_set(instance);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *saved) {
    (void)instance;
    free(*saved);
    *saved = NULL;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState saved, size_t *size) {
    (void)instance, (void)saved;
    *size = sizeof(State);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState saved, fmi3Byte bytes[], size_t size) {
    if (size < sizeof(State)) return refuse(instance, "fmi3SerializeFMUState", "too few bytes");
    memcpy(bytes, saved, sizeof(State));
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *saved) {
    if (size != sizeof(State)) return refuse(instance, "fmi3DeserializeFMUState", "not a state of this FMU");
    if (!*saved) *saved = malloc(sizeof(State));
    if (!*saved) return refuse(instance, "fmi3DeserializeFMUState", "out of memory");
    memcpy(*saved, bytes, sizeof(State));
    return fmi3OK;
}

/* ------------------------------------------------------------------ what the model has no use for, by name */

#define NO_TYPE(TYPE)                                                                                              \
    FMI3_Export fmi3Status fmi3Get##TYPE(fmi3Instance instance, const fmi3ValueReference vrs[], size_t nVrs,        \
                                         fmi3##TYPE values[], size_t nValues) {                                     \
        (void)vrs, (void)values, (void)nValues;                                                                     \
        return nVrs == 0 ? fmi3OK : not_supported(instance, "fmi3Get" #TYPE);                                       \
    }                                                                                                               \
    FMI3_Export fmi3Status fmi3Set##TYPE(fmi3Instance instance, const fmi3ValueReference vrs[], size_t nVrs,        \
                                         const fmi3##TYPE values[], size_t nValues) {                               \
        (void)vrs, (void)values, (void)nValues;                                                                     \
        return nVrs == 0 ? fmi3OK : not_supported(instance, "fmi3Set" #TYPE);                                       \
    }
NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(Int64)
NO_TYPE(UInt64)
NO_TYPE(String)

#define NOT_SUPPORTED(NAME, ...)                                     \
    FMI3_Export fmi3Status NAME(fmi3Instance instance, __VA_ARGS__) { \
        return not_supported(instance, #NAME);                        \
    }
#define NOT_SUPPORTED_ALONE(NAME)                                    \
    FMI3_Export fmi3Status NAME(fmi3Instance instance) {              \
        return not_supported(instance, #NAME);                        \
    }
#define VRS const fmi3ValueReference a[], size_t b
NOT_SUPPORTED(fmi3GetBinary, VRS, size_t c[], fmi3Binary d[], size_t e)
NOT_SUPPORTED(fmi3SetBinary, VRS, const size_t c[], const fmi3Binary d[], size_t e)
NOT_SUPPORTED(fmi3GetClock, VRS, fmi3Clock c[])
NOT_SUPPORTED(fmi3SetClock, VRS, const fmi3Clock c[])
NOT_SUPPORTED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference a, size_t *b)
NOT_SUPPORTED(fmi3GetVariableDependencies, fmi3ValueReference a, size_t b[], fmi3ValueReference c[], size_t d[],
              fmi3DependencyKind e[], size_t f)
NOT_SUPPORTED(fmi3GetAdjointDerivative, VRS, const fmi3ValueReference c[], size_t d, const fmi3Float64 e[], size_t f,
              fmi3Float64 g[], size_t h)
NOT_SUPPORTED(fmi3GetIntervalDecimal, VRS, fmi3Float64 c[], fmi3IntervalQualifier d[])
NOT_SUPPORTED(fmi3GetIntervalFraction, VRS, fmi3UInt64 c[], fmi3UInt64 d[], fmi3IntervalQualifier e[])
NOT_SUPPORTED(fmi3GetShiftDecimal, VRS, fmi3Float64 c[])
NOT_SUPPORTED(fmi3GetShiftFraction, VRS, fmi3UInt64 c[], fmi3UInt64 d[])
NOT_SUPPORTED(fmi3SetIntervalDecimal, VRS, const fmi3Float64 c[])
NOT_SUPPORTED(fmi3SetIntervalFraction, VRS, const fmi3UInt64 c[], const fmi3UInt64 d[])
NOT_SUPPORTED(fmi3SetShiftDecimal, VRS, const fmi3Float64 c[])
NOT_SUPPORTED(fmi3SetShiftFraction, VRS, const fmi3UInt64 c[], const fmi3UInt64 d[])
NOT_SUPPORTED(fmi3GetOutputDerivatives, VRS, const fmi3Int32 c[], fmi3Float64 d[], size_t e)
NOT_SUPPORTED(fmi3ActivateModelPartition, fmi3ValueReference a, fmi3Float64 b)
NOT_SUPPORTED_ALONE(fmi3EnterStepMode)

FMI3_Export fmi3Instance fmi3InstantiateScheduledExecution(fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d,
                                                           fmi3Boolean e, fmi3InstanceEnvironment f,
                                                           fmi3LogMessageCallback g, fmi3ClockUpdateCallback h,
                                                           fmi3LockPreemptionCallback i, fmi3UnlockPreemptionCallback j) {
    (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g, (void)h, (void)i, (void)j;
    return NULL;
}
