// The chain as a co-simulation FMU 2.0.
#include "arm.c"
#include "fmi2Functions.h"

API fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
                                  fmi2String resources, const fmi2CallbackFunctions *callbacks,
                                  fmi2Boolean visible, fmi2Boolean logging) {
    chain *c = malloc(sizeof *c);
    begin(c);
    return c;
}
API void fmi2FreeInstance(fmi2Component c) { free(c); }
API fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d,
                                   fmi2Boolean e, fmi2Real f) {
    return fmi2OK;
}
API fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
API fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
API fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
API fmi2Status fmi2Reset(fmi2Component c) {
    begin(c);
    return fmi2OK;
}
API fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                           const fmi2Real x[]) {
    set(c, r, n, x);
    return fmi2OK;
}
API fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real x[]) {
    get(c, r, n, x);
    return fmi2OK;
}
API fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep) {
    advance(((chain *)c)->v, h);
    return fmi2OK;
}
