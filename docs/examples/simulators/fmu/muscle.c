/* A muscle and its chamber as an FMU: FMI 2.0 or 3.0, co-simulation (-DFMI=2 or -DFMI=3).

   force    = p (3 L^2 - b^2) / (4 pi n^2)       p, L inputs; Chou and Hannaford (1996), eq. 11
   pressure : dP/dt = r (inlet (supply - P) - outlet P), P(0) = 0

   All quantities in SI: Pa, m, N, s. `fault` makes a step fail, or gives no number, for tests. */

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>

enum { PRESSURE_IN, LENGTH, INLET, OUTLET, SUPPLY, BRAID, TURNS, RATE, FORCE, PRESSURE, FAULT, COUNT };
enum { OK = 0, ERROR = 3 };

typedef struct {
    double value[COUNT];
} Model;

static void reset(Model *m)
{
    const double start[COUNT] = {0.0, 0.06, 0.0, 0.0, 7e5, 0.085, 1.75, 5.0, 0.0, 0.0, 0.0};
    for (int i = 0; i < COUNT; i++) m->value[i] = start[i];
}

static void output(Model *m)
{
    const double *v = m->value;
    const double pi = acos(-1.0), b = v[BRAID], n = v[TURNS], length = v[LENGTH];
    m->value[FORCE] = v[PRESSURE_IN] * (3.0 * length * length - b * b) / (4.0 * pi * n * n);
    if (v[FAULT] == 2.0) m->value[FORCE] = NAN;
}

/* The chamber is linear over a step in which its inputs stand still: its exact solution. */
static int step(Model *m, double h)
{
    double *v = m->value;
    if (v[FAULT] == 1.0) return ERROR;
    const double k = v[RATE] * (v[INLET] + v[OUTLET]);
    if (k > 0.0) {
        const double end = v[RATE] * v[INLET] * v[SUPPLY] / k;
        v[PRESSURE] = end + (v[PRESSURE] - end) * exp(-k * h);
    }
    output(m);
    return OK;
}

static int get(Model *m, const unsigned *reference, size_t count, double *value)
{
    output(m);
    for (size_t i = 0; i < count; i++) {
        if (reference[i] >= COUNT) return ERROR;
        value[i] = m->value[reference[i]];
    }
    return OK;
}

static int set(Model *m, const unsigned *reference, size_t count, const double *value)
{
    for (size_t i = 0; i < count; i++) {
        if (reference[i] >= COUNT) return ERROR;
        m->value[reference[i]] = value[i];
    }
    return OK;
}

static void *make(void)
{
    Model *m = malloc(sizeof *m);
    if (m) reset(m);
    return m;
}

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif
#define NONE(name) EXPORT int name(void) { return ERROR; }
#define FINE(name) EXPORT int name(void *m) { (void)m; return OK; }

#if FMI == 2

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *resources,
                             const void *callbacks, int visible, int logging)
{
    (void)name, (void)kind, (void)guid, (void)resources, (void)callbacks, (void)visible;
    (void)logging;
    return make();
}
EXPORT void fmi2FreeInstance(void *m) { free(m); }
EXPORT int fmi2SetupExperiment(void *m, int limited, double tolerance, double start, int ends,
                               double stop)
{
    (void)m, (void)limited, (void)tolerance, (void)start, (void)ends, (void)stop;
    return OK;
}
EXPORT int fmi2Reset(void *m) { reset(m); return OK; }
EXPORT int fmi2GetReal(void *m, const unsigned *r, size_t n, double *v) { return get(m, r, n, v); }
EXPORT int fmi2SetReal(void *m, const unsigned *r, size_t n, const double *v)
{
    return set(m, r, n, v);
}
EXPORT int fmi2DoStep(void *m, double now, double h, int last)
{
    (void)now, (void)last;
    return step(m, h);
}
FINE(fmi2EnterInitializationMode)
FINE(fmi2ExitInitializationMode)
FINE(fmi2Terminate)
NONE(fmi2SetDebugLogging) NONE(fmi2GetInteger) NONE(fmi2GetBoolean) NONE(fmi2GetString)
NONE(fmi2SetInteger) NONE(fmi2SetBoolean) NONE(fmi2SetString) NONE(fmi2GetFMUstate)
NONE(fmi2SetFMUstate) NONE(fmi2FreeFMUstate) NONE(fmi2SerializedFMUstateSize)
NONE(fmi2SerializeFMUstate) NONE(fmi2DeSerializeFMUstate) NONE(fmi2GetDirectionalDerivative)
NONE(fmi2SetRealInputDerivatives) NONE(fmi2GetRealOutputDerivatives) NONE(fmi2CancelStep)
NONE(fmi2GetStatus) NONE(fmi2GetRealStatus) NONE(fmi2GetIntegerStatus) NONE(fmi2GetBooleanStatus)
NONE(fmi2GetStringStatus)

#else

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT void *fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *resources, bool visible, bool logging,
    bool events, bool early, const unsigned *required, size_t count, void *environment, void *log,
    void *update)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events;
    (void)early, (void)required, (void)count, (void)environment, (void)log, (void)update;
    return make();
}
EXPORT void fmi3FreeInstance(void *m) { free(m); }
EXPORT int fmi3EnterInitializationMode(void *m, bool limited, double tolerance, double start,
                                       bool ends, double stop)
{
    (void)m, (void)limited, (void)tolerance, (void)start, (void)ends, (void)stop;
    return OK;
}
EXPORT int fmi3Reset(void *m) { reset(m); return OK; }
EXPORT int fmi3GetFloat64(void *m, const unsigned *r, size_t n, double *v, size_t values)
{
    (void)values;
    return get(m, r, n, v);
}
EXPORT int fmi3SetFloat64(void *m, const unsigned *r, size_t n, const double *v, size_t values)
{
    (void)values;
    return set(m, r, n, v);
}
EXPORT int fmi3DoStep(void *m, double now, double h, bool kept, bool *event, bool *ends,
                      bool *early, double *reached)
{
    (void)kept;
    *event = *ends = *early = false;
    *reached = now + h;
    return step(m, h);
}
FINE(fmi3ExitInitializationMode)
FINE(fmi3Terminate)
NONE(fmi3SetDebugLogging) NONE(fmi3InstantiateModelExchange) NONE(fmi3InstantiateScheduledExecution)
NONE(fmi3EnterEventMode) NONE(fmi3GetFloat32) NONE(fmi3GetInt8) NONE(fmi3GetUInt8)
NONE(fmi3GetInt16) NONE(fmi3GetUInt16) NONE(fmi3GetInt32) NONE(fmi3GetUInt32) NONE(fmi3GetInt64)
NONE(fmi3GetUInt64) NONE(fmi3GetBoolean) NONE(fmi3GetString) NONE(fmi3GetBinary) NONE(fmi3GetClock)
NONE(fmi3SetFloat32) NONE(fmi3SetInt8) NONE(fmi3SetUInt8) NONE(fmi3SetInt16) NONE(fmi3SetUInt16)
NONE(fmi3SetInt32) NONE(fmi3SetUInt32) NONE(fmi3SetInt64) NONE(fmi3SetUInt64) NONE(fmi3SetBoolean)
NONE(fmi3SetString) NONE(fmi3SetBinary) NONE(fmi3SetClock)
NONE(fmi3GetNumberOfVariableDependencies) NONE(fmi3GetVariableDependencies) NONE(fmi3GetFMUState)
NONE(fmi3SetFMUState) NONE(fmi3FreeFMUState) NONE(fmi3SerializedFMUStateSize)
NONE(fmi3SerializeFMUState) NONE(fmi3DeserializeFMUState) NONE(fmi3GetDirectionalDerivative)
NONE(fmi3GetAdjointDerivative) NONE(fmi3EnterConfigurationMode) NONE(fmi3ExitConfigurationMode)
NONE(fmi3GetIntervalDecimal) NONE(fmi3GetIntervalFraction) NONE(fmi3GetShiftDecimal)
NONE(fmi3GetShiftFraction) NONE(fmi3SetIntervalDecimal) NONE(fmi3SetIntervalFraction)
NONE(fmi3SetShiftDecimal) NONE(fmi3SetShiftFraction) NONE(fmi3EvaluateDiscreteStates)
NONE(fmi3UpdateDiscreteStates) NONE(fmi3EnterStepMode) NONE(fmi3GetOutputDerivatives)
NONE(fmi3ActivateModelPartition) NONE(fmi3CompletedIntegratorStep)
NONE(fmi3EnterContinuousTimeMode) NONE(fmi3GetContinuousStateDerivatives)
NONE(fmi3GetContinuousStates) NONE(fmi3GetEventIndicators) NONE(fmi3GetNominalsOfContinuousStates)
NONE(fmi3GetNumberOfContinuousStates) NONE(fmi3GetNumberOfEventIndicators)
NONE(fmi3SetContinuousStates) NONE(fmi3SetTime)

#endif
