/*
 * A Panoscope plugin with one node: `make test` tries it, `panoscope run {{name}}.toml` runs it.
 * The texts in the descriptors are the tooltips that users read.
 */
#include <panoscope.h>

PANOSCOPE_NOTE("{{name}}", "0.1.0", "{{node}}");

enum { GAIN }; /* the order of PARAMS */

static const PanoscopePort INPUTS[] = { {
    .name = PANOSCOPE_STR("image"),
    .doc = PANOSCOPE_STR("Picture to brighten."),
    .packet = PANOSCOPE_STR("image"),
    .formats = PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_BGR8),
} };

static const PanoscopePort OUTPUTS[] = { {
    .name = PANOSCOPE_STR("image"),
    .doc = PANOSCOPE_STR("The brighter picture."),
    .packet = PANOSCOPE_STR("image"),
    .formats = PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_BGR8),
} };

static const PanoscopeParam PARAMS[] = {
    { .name = PANOSCOPE_STR("gain"), .doc = PANOSCOPE_STR("What every colour is multiplied by."),
      .unit = PANOSCOPE_STR("ratio"), .kind = PANOSCOPE_PARAM_FLOAT, .default_number = 1.5, .min = 0.0, .max = 8.0 },
};

static PanoscopeStatus node_open(PanoscopeOpenCall *call, void **instance) {
    (void)call;
    *instance = NULL; /* or a struct of your own, freed in node_close */
    return PANOSCOPE_STATUS_OK;
}

static PanoscopeStatus node_process(void *instance, PanoscopeCall *call) {
    (void)instance;
    const PanoscopeFrame *image = panoscope_input(call, 0);
    const double gain = call->params[GAIN].float_value;
    const PanoscopeFrame *out = panoscope_alloc_image(call, 0, PANOSCOPE_FORMAT_BGR8, image->width, image->height, 3);
    if (!out) {
        return PANOSCOPE_STATUS_EXHAUSTED;
    }
    for (uint32_t y = 0; y < image->height; y++) {
        const uint8_t *from = panoscope_row(image, y);
        uint8_t *to = panoscope_row(out, y);
        for (uint32_t i = 0; i < 3 * image->width; i++) {
            const double bright = from[i] * gain + 0.5;
            to[i] = bright > 255.0 ? 255 : (uint8_t)bright;
        }
    }
    return PANOSCOPE_STATUS_OK;
}

static void node_close(void *instance) {
    (void)instance;
}

static const PanoscopeNodeType NODE = {
    .struct_size = sizeof(PanoscopeNodeType),
    .kind = PANOSCOPE_KIND_COMPUTE,
    .name = PANOSCOPE_STR("{{node}}"),
    .family = PANOSCOPE_STR("filter"),
    .doc = PANOSCOPE_STR("Makes a picture brighter."),
    .inputs = INPUTS, .inputs_len = PANOSCOPE_COUNT(INPUTS),
    .outputs = OUTPUTS, .outputs_len = PANOSCOPE_COUNT(OUTPUTS),
    .params = PARAMS, .params_len = PANOSCOPE_COUNT(PARAMS),
    .open = node_open, .process = node_process, .close = node_close,
};
static const PanoscopeNodeType *const NODE_TYPES[] = { &NODE };

PANOSCOPE_EXPORT const PanoscopePlugin *panoscope_plugin(void) {
    static const PanoscopePlugin PLUGIN = {
        .magic = PANOSCOPE_MAGIC,
        .abi_major = PANOSCOPE_ABI_MAJOR, .abi_minor = PANOSCOPE_ABI_MINOR,
        .struct_size = sizeof(PanoscopePlugin),
        .name = PANOSCOPE_STR("{{name}}"),
        .version = PANOSCOPE_STR("0.1.0"),
        .doc = PANOSCOPE_STR("A Panoscope plugin."),
        .node_types = NODE_TYPES, .node_types_len = PANOSCOPE_COUNT(NODE_TYPES),
        .note = &panoscope_note,
    };
    return &PLUGIN;
}
