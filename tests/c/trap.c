/*
 * A plugin that tells when its code runs: its constructor appends a line to the file that PANOSCOPE_TRAP names.
 * Build: cc -std=c11 -O2 -fPIC -fvisibility=hidden -shared -I core/contract/abi trap.c -o libtrap.so; with -DNEEDS_LIBRARY it needs libtrap_library.so,
 * which -DLIBRARY builds from the same file.
 */
#include <stdio.h>
#include <stdlib.h>

#ifdef LIBRARY
#define WHO "library"
#else
#define WHO "plugin"
#endif

__attribute__((constructor)) static void tell(void) {
    const char *name = getenv("PANOSCOPE_TRAP");
    FILE *file = name ? fopen(name, "a") : NULL;
    if (file) {
        fputs(WHO "\n", file);
        fclose(file);
    }
}

#ifdef LIBRARY

/* Another number makes another file. */
#ifndef ANSWER
#define ANSWER 42
#endif
__attribute__((visibility("default"))) int trap_library(void) {
    return ANSWER;
}

#else

#include <panoscope.h>

PANOSCOPE_NOTE("trap", "1.0.0", "trap");

#ifdef NEEDS_LIBRARY
int trap_library(void);
#else
static int trap_library(void) {
    return 42;
}
#endif

static const PanoscopePort INPUTS[] = { {
    .name = PANOSCOPE_STR("image"),
    .doc = PANOSCOPE_STR("Any gray picture."),
    .packet = PANOSCOPE_STR("image"),
    .formats = PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_GRAY8),
} };

static PanoscopeStatus trap_open(PanoscopeOpenCall *call, void **instance) {
    (void)call;
    *instance = NULL;
    return trap_library() == 0 ? PANOSCOPE_STATUS_EXHAUSTED : PANOSCOPE_STATUS_OK;
}

static PanoscopeStatus trap_process(void *instance, PanoscopeCall *call) {
    (void)instance;
    (void)call;
    return PANOSCOPE_STATUS_OK;
}

static void trap_close(void *instance) {
    (void)instance;
}

static const PanoscopeNodeType TRAP = {
    .struct_size = sizeof(PanoscopeNodeType),
    .kind = PANOSCOPE_KIND_COMPUTE,
    .name = PANOSCOPE_STR("trap"),
    .family = PANOSCOPE_STR("sink"),
    .doc = PANOSCOPE_STR("Takes pictures."),
    .inputs = INPUTS, .inputs_len = PANOSCOPE_COUNT(INPUTS),
    .open = trap_open, .process = trap_process, .close = trap_close,
};
static const PanoscopeNodeType *const NODE_TYPES[] = { &TRAP };

PANOSCOPE_EXPORT const PanoscopePlugin *panoscope_plugin(void) {
    static const PanoscopePlugin PLUGIN = {
        .magic = PANOSCOPE_MAGIC,
        .abi_major = PANOSCOPE_ABI_MAJOR, .abi_minor = PANOSCOPE_ABI_MINOR,
        .struct_size = sizeof(PanoscopePlugin),
        .name = PANOSCOPE_STR("trap"),
        .version = PANOSCOPE_STR("1.0.0"),
        .doc = PANOSCOPE_STR("Tells when its code runs."),
        .node_types = NODE_TYPES, .node_types_len = PANOSCOPE_COUNT(NODE_TYPES),
        .note = &panoscope_note,
    };
    return &PLUGIN;
}

#endif
