/*
 * A plugin whose constructor does something before anybody asked: with -DMARK="file" it writes its process number to the file, with -DCRASH it
 * crashes, with -DHANG it never returns. Its node passes pictures on.
 */
#include <panoscope.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

PANOSCOPE_NOTE("constructor", "1.0.0", "passes");

__attribute__((constructor)) static void before_anybody_asked(void) {
#ifdef MARK
    char text[32];
    const int file = open(MARK, O_WRONLY | O_CREAT | O_APPEND, 0600);
    if (file >= 0) {
        const int len = snprintf(text, sizeof text, "%d\n", (int)getpid());
        if (write(file, text, (size_t)len) != len) {
            abort();
        }
        close(file);
    }
#endif
#ifdef CRASH
    *(volatile char *)16 = 1;
#endif
#ifdef HANG
    for (;;) {
        pause();
    }
#endif
}

static const PanoscopePort INPUTS[] = { {
    .name = PANOSCOPE_STR("image"),
    .doc = PANOSCOPE_STR("Picture."),
    .packet = PANOSCOPE_STR("image"),
    .formats = PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_GRAY8),
} };

static const PanoscopePort OUTPUTS[] = { {
    .name = PANOSCOPE_STR("image"),
    .doc = PANOSCOPE_STR("The same picture."),
    .packet = PANOSCOPE_STR("image"),
    .formats = PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_GRAY8),
} };

static const PanoscopeParam PARAMS[] = {
    { .name = PANOSCOPE_STR("odd"), .doc = PANOSCOPE_STR("An odd number; `validate` refuses others."),
      .kind = PANOSCOPE_PARAM_INT, .default_number = 1, .min = 0, .max = 9 },
};

static PanoscopeStatus passes_validate(PanoscopeValidateCall *call) {
    if (call->params[0].int_value % 2 == 0) {
        const PanoscopeStr message = PANOSCOPE_STR("the number is even"), help = PANOSCOPE_STR("take an odd one");
        call->invalid(call->call, PANOSCOPE_PROBLEM_ERROR, 0, message, help);
    }
    return PANOSCOPE_STATUS_OK;
}

static PanoscopeStatus passes_open(PanoscopeOpenCall *call, void **instance) {
    (void)call;
    *instance = NULL;
    return PANOSCOPE_STATUS_OK;
}

static PanoscopeStatus passes_process(void *instance, PanoscopeCall *call) {
    (void)instance;
    return call->host->forward(call->call, 0, panoscope_input(call, 0));
}

static void passes_close(void *instance) {
    (void)instance;
}

static const PanoscopeNodeType PASSES = {
    .struct_size = sizeof(PanoscopeNodeType),
    .kind = PANOSCOPE_KIND_COMPUTE,
    .name = PANOSCOPE_STR("passes"),
    .family = PANOSCOPE_STR("filter"),
    .doc = PANOSCOPE_STR("Passes pictures on."),
    .inputs = INPUTS,
    .inputs_len = 1,
    .outputs = OUTPUTS,
    .outputs_len = 1,
    .params = PARAMS,
    .params_len = 1,
    .open = passes_open,
    .process = passes_process,
    .close = passes_close,
    .validate = passes_validate,
};

static const PanoscopeNodeType *const NODE_TYPES[] = { &PASSES };

PANOSCOPE_EXPORT const PanoscopePlugin *panoscope_plugin(void) {
    static const PanoscopePlugin PLUGIN = {
        .magic = PANOSCOPE_MAGIC,
        .abi_major = PANOSCOPE_ABI_MAJOR, .abi_minor = PANOSCOPE_ABI_MINOR,
        .struct_size = sizeof(PanoscopePlugin),
        .name = PANOSCOPE_STR("constructor"),
        .version = PANOSCOPE_STR("1.0.0"),
        .doc = PANOSCOPE_STR("Does something before anybody asked."),
        .node_types = NODE_TYPES, .node_types_len = PANOSCOPE_COUNT(NODE_TYPES),
        .note = &panoscope_note,
    };
    return &PLUGIN;
}
