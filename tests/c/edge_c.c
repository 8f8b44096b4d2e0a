/*
 * Edges of a gray image with the Sobel operator: a complete plugin in C.
 * Build: cc -std=c11 -O2 -fPIC -fvisibility=hidden -shared -I core/contract/abi edge_c.c -o libedge_c.so
 */
#include <panoscope.h>
#include <stdlib.h>

PANOSCOPE_NOTE("edge_c", "1.0.0", "edge_c");

enum { THRESHOLD, GAIN }; /* the order of PARAMS */

static const PanoscopePort INPUTS[] = { {
    .name = PANOSCOPE_STR("image"),
    .doc = PANOSCOPE_STR("Picture to search."),
    .packet = PANOSCOPE_STR("image"),
    .formats = PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_GRAY8),
} };

static const PanoscopePort OUTPUTS[] = { {
    .name = PANOSCOPE_STR("edges"),
    .doc = PANOSCOPE_STR("Strength of the edge at each pixel, 0 to 255; 0 along the border."),
    .packet = PANOSCOPE_STR("image"),
    .formats = PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_GRAY8),
} };

static const PanoscopeParam PARAMS[] = {
    { .name = PANOSCOPE_STR("threshold"), .doc = PANOSCOPE_STR("Weaker edges are left out."),
      .kind = PANOSCOPE_PARAM_INT, .default_number = 32, .min = 0, .max = 255 },
    { .name = PANOSCOPE_STR("gain"), .doc = PANOSCOPE_STR("Factor on the strength."), .unit = PANOSCOPE_STR("ratio"),
      .kind = PANOSCOPE_PARAM_FLOAT, .default_number = 0.25, .min = 0.0, .max = 4.0 },
};

/* Nothing is kept from call to call, so the instance is a null pointer. */
static PanoscopeStatus edge_open(PanoscopeOpenCall *call, void **instance) {
    (void)call;
    *instance = NULL;
    return PANOSCOPE_STATUS_OK;
}

static PanoscopeStatus edge_process(void *instance, PanoscopeCall *call) {
    (void)instance;
    const PanoscopeFrame *image = panoscope_input(call, 0);
    const double threshold = (double)call->params[THRESHOLD].int_value;
    const double gain = call->params[GAIN].float_value;
    if (image->width < 3 || image->height < 3) {
        return panoscope_fail(call->host, call->call, "the image is smaller than 3x3 pixels");
    }
    const PanoscopeFrame *edges =
        panoscope_alloc_image(call, 0, PANOSCOPE_FORMAT_GRAY8, image->width, image->height, 1);
    if (!edges) {
        return PANOSCOPE_STATUS_EXHAUSTED;
    }
    memset(edges->data, 0, edges->len);
    for (uint32_t y = 1; y + 1 < image->height; y++) {
        const uint8_t *above = panoscope_row(image, y - 1);
        const uint8_t *here = panoscope_row(image, y);
        const uint8_t *below = panoscope_row(image, y + 1);
        uint8_t *out = panoscope_row(edges, y);
        for (uint32_t x = 1; x + 1 < image->width; x++) {
            const int right = above[x + 1] + 2 * here[x + 1] + below[x + 1];
            const int left = above[x - 1] + 2 * here[x - 1] + below[x - 1];
            const int down = below[x - 1] + 2 * below[x] + below[x + 1];
            const int up = above[x - 1] + 2 * above[x] + above[x + 1];
            const double strength = gain * (abs(right - left) + abs(down - up));
            out[x] = strength < threshold ? 0 : strength > 255.0 ? 255 : (uint8_t)strength;
        }
    }
    return PANOSCOPE_STATUS_OK;
}

static void edge_close(void *instance) {
    (void)instance;
}

static const PanoscopeNodeType EDGE = {
    .struct_size = sizeof(PanoscopeNodeType),
    .kind = PANOSCOPE_KIND_COMPUTE,
    .name = PANOSCOPE_STR("edge_c"),
    .family = PANOSCOPE_STR("filter"),
    .doc = PANOSCOPE_STR("Edges of a gray image with the Sobel operator."),
    .inputs = INPUTS, .inputs_len = PANOSCOPE_COUNT(INPUTS),
    .outputs = OUTPUTS, .outputs_len = PANOSCOPE_COUNT(OUTPUTS),
    .params = PARAMS, .params_len = PANOSCOPE_COUNT(PARAMS),
    .open = edge_open, .process = edge_process, .close = edge_close,
};
static const PanoscopeNodeType *const NODE_TYPES[] = { &EDGE };

PANOSCOPE_EXPORT const PanoscopePlugin *panoscope_plugin(void) {
    static const PanoscopePlugin PLUGIN = {
        .magic = PANOSCOPE_MAGIC,
        .abi_major = PANOSCOPE_ABI_MAJOR, .abi_minor = PANOSCOPE_ABI_MINOR,
        .struct_size = sizeof(PanoscopePlugin),
        .name = PANOSCOPE_STR("edge_c"),
        .version = PANOSCOPE_STR("1.0.0"),
        .doc = PANOSCOPE_STR("An example in C."),
        .node_types = NODE_TYPES, .node_types_len = PANOSCOPE_COUNT(NODE_TYPES),
        .note = &panoscope_note,
    };
    return &PLUGIN;
}
