// The chain as a co-simulation FMU 3.0.
#include "arm.c"
#include "fmi3Functions.h"

API fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference between[],
    size_t n, fmi3InstanceEnvironment of, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update) {
    chain *c = malloc(sizeof *c);
    begin(c);
    return c;
}
API void fmi3FreeInstance(fmi3Instance c) { free(c); }
API fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b,
                                           fmi3Float64 d, fmi3Boolean e, fmi3Float64 f) {
    return fmi3OK;
}
API fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }
API fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
API fmi3Status fmi3Reset(fmi3Instance c) {
    begin(c);
    return fmi3OK;
}
API fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                              const fmi3Float64 x[], size_t many) {
    set(c, r, n, x);
    return fmi3OK;
}
API fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                              fmi3Float64 x[], size_t many) {
    get(c, r, n, x);
    return fmi3OK;
}
API fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep,
                          fmi3Boolean *event, fmi3Boolean *end, fmi3Boolean *early,
                          fmi3Float64 *last) {
    advance(((chain *)c)->v, h);
    *event = *end = *early = fmi3False;
    *last = t + h;
    return fmi3OK;
}
