// Edges of a gray image with a choice of operators: a complete plugin in C++.
// Build: c++ -std=c++17 -O2 -fPIC -fvisibility=hidden -fno-gnu-unique -shared -I core/contract/abi edge_cpp.cpp -o libedge_cpp.so
#include <panoscope.h>

#include <cmath>
#include <stdexcept>
#include <string>

PANOSCOPE_NOTE("edge_cpp", "1.0.0", "edge_cpp");

namespace {

enum { KERNEL, THROWS };  // the order of PARAMS

// Weights of the side and the middle pixel, so that a step of 1 gives 1.
struct Weights { float side, middle; };
constexpr Weights WEIGHTS[] = { { 0.25f, 0.5f }, { 0.1875f, 0.625f }, { 1.0f / 3, 1.0f / 3 } };
const PanoscopeStr KERNELS[] = { PANOSCOPE_STR("sobel"), PANOSCOPE_STR("scharr"), PANOSCOPE_STR("prewitt") };
const PanoscopeStr THROWN[] = { PANOSCOPE_STR("nothing"), PANOSCOPE_STR("exception"), PANOSCOPE_STR("number") };

PanoscopePort port(const char *name, const char *doc) {
    PanoscopePort port{};
    port.name = panoscope_str(name);
    port.doc = panoscope_str(doc);
    port.packet = panoscope_str("image");
    port.formats = PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_GRAY8);
    return port;
}

template <size_t N>
PanoscopeParam choice(const char *name, const char *doc, const PanoscopeStr (&words)[N]) {
    PanoscopeParam param{};
    param.name = panoscope_str(name);
    param.doc = panoscope_str(doc);
    param.kind = PANOSCOPE_PARAM_CHOICE;
    param.choices = words;
    param.choices_len = N;
    return param;
}

const PanoscopePort INPUTS[] = { port("image", "Picture to search.") };
const PanoscopePort OUTPUTS[] = { port("edges", "Strength of the edge at each pixel, 0 to 255; 0 along the border.") };
const PanoscopeParam PARAMS[] = {
    choice("kernel", "Weights of the neighbours.", KERNELS),
    choice("throws", "What is thrown instead of working, to try the guard.", THROWN),
};

class Edge {
public:
    void process(PanoscopeCall &call) {
        const PanoscopeFrame *image = panoscope_input(&call, 0);
        if (call.params[THROWS].index == 1) throw std::runtime_error("thrown in tick " + std::to_string(call.tick.seq));
        if (call.params[THROWS].index == 2) throw 42;
        const PanoscopeFrame *edges =
            panoscope_alloc_image(&call, 0, PANOSCOPE_FORMAT_GRAY8, image->width, image->height, 1);
        if (!edges) throw std::runtime_error("the host has no memory for the edges");
        memset(edges->data, 0, edges->len);
        const Weights w = WEIGHTS[call.params[KERNEL].index];
        for (uint32_t y = 1; y + 1 < image->height; y++) {
            const uint8_t *a = panoscope_row(image, y - 1), *h = panoscope_row(image, y), *b = panoscope_row(image, y + 1);
            uint8_t *out = panoscope_row(edges, y);
            for (uint32_t x = 1; x + 1 < image->width; x++) {
                const float across = w.side * float(a[x + 1] - a[x - 1]) + w.middle * float(h[x + 1] - h[x - 1]) +
                                     w.side * float(b[x + 1] - b[x - 1]);
                const float down = w.side * float(b[x - 1] - a[x - 1]) + w.middle * float(b[x] - a[x]) +
                                   w.side * float(b[x + 1] - a[x + 1]);
                out[x] = uint8_t(std::fmin(std::sqrt(across * across + down * down) + 0.5f, 255.0f));
            }
        }
    }
};

PanoscopeStatus open(PanoscopeOpenCall *call, void **instance) {
    PANOSCOPE_GUARD_BEGIN(call)
    *instance = new Edge;
    return PANOSCOPE_STATUS_OK;
    PANOSCOPE_GUARD_END
}

PanoscopeStatus process(void *instance, PanoscopeCall *call) {
    PANOSCOPE_GUARD_BEGIN(call)
    static_cast<Edge *>(instance)->process(*call);
    return PANOSCOPE_STATUS_OK;
    PANOSCOPE_GUARD_END
}

void close(void *instance) { delete static_cast<Edge *>(instance); }

const PanoscopeNodeType EDGE = [] {
    PanoscopeNodeType type{};
    type.struct_size = sizeof type;
    type.kind = PANOSCOPE_KIND_COMPUTE;
    type.name = panoscope_str("edge_cpp");
    type.family = panoscope_str("filter");
    type.doc = panoscope_str("Edges of a gray image with a choice of operators.");
    type.inputs = INPUTS, type.inputs_len = PANOSCOPE_COUNT(INPUTS);
    type.outputs = OUTPUTS, type.outputs_len = PANOSCOPE_COUNT(OUTPUTS);
    type.params = PARAMS, type.params_len = PANOSCOPE_COUNT(PARAMS);
    type.open = open, type.process = process, type.close = close;
    return type;
}();
const PanoscopeNodeType *const NODE_TYPES[] = { &EDGE };

const PanoscopePlugin PLUGIN = [] {
    PanoscopePlugin plugin{};
    plugin.magic = PANOSCOPE_MAGIC;
    plugin.abi_major = PANOSCOPE_ABI_MAJOR, plugin.abi_minor = PANOSCOPE_ABI_MINOR;
    plugin.struct_size = sizeof plugin;
    plugin.name = panoscope_str("edge_cpp"), plugin.version = panoscope_str("1.0.0");
    plugin.doc = panoscope_str("An example in C++.");
    plugin.node_types = NODE_TYPES, plugin.node_types_len = PANOSCOPE_COUNT(NODE_TYPES);
    plugin.note = &panoscope_note;
    return plugin;
}();

}  // namespace

PANOSCOPE_EXPORT const PanoscopePlugin *panoscope_plugin(void) { return &PLUGIN; }
