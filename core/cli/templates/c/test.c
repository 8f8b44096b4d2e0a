/* Loads the plugin, runs one frame through its node with a host of a few lines, and compares. */
#include <panoscope.h>
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

typedef struct { PanoscopeFrame output; } Call;

static PanoscopeStatus host_alloc(void *call, uint32_t output, uint32_t format, uint32_t width, uint32_t height,
                                  uint32_t stride_bytes, size_t len) {
    if (output != 0) {
        return PANOSCOPE_STATUS_INVALID;
    }
    PanoscopeFrame *frame = &((Call *)call)->output;
    frame->buffer.pool = 1;
    frame->data = malloc(len ? len : 1);
    frame->len = len;
    frame->format = format;
    frame->width = width;
    frame->height = height;
    frame->stride_bytes = stride_bytes;
    return frame->data ? PANOSCOPE_STATUS_OK : PANOSCOPE_STATUS_EXHAUSTED;
}

static void host_fail(void *call, PanoscopeStr words) {
    (void)call;
    fprintf(stderr, "the node said: %.*s\n", (int)words.len, (const char *)words.ptr);
}

static int wrong(const char *what) {
    fprintf(stderr, "FAILED: %s\n", what);
    return 1;
}

int main(int count, char **arguments) {
    void *library = count > 1 ? dlopen(arguments[1], RTLD_NOW | RTLD_LOCAL) : NULL;
    if (!library) {
        return wrong(count > 1 ? dlerror() : "give the plugin's file");
    }
    /* ISO C has no cast from a pointer to data to one to a function: copy the bits. */
    const PanoscopePlugin *(*entry)(void) = NULL;
    void *symbol = dlsym(library, PANOSCOPE_ENTRY_SYMBOL);
    memcpy(&entry, &symbol, sizeof entry);
    const PanoscopePlugin *plugin = entry ? entry() : NULL;
    if (!plugin || plugin->magic != PANOSCOPE_MAGIC || plugin->node_types_len != 1) {
        return wrong("the library is no plugin with one node type");
    }
    const PanoscopeNodeType *type = plugin->node_types[0];

    const PanoscopeHost host = { .struct_size = sizeof host, .abi_major = PANOSCOPE_ABI_MAJOR,
                                 .abi_minor = PANOSCOPE_ABI_MINOR, .threads = 1, .alloc = host_alloc, .fail = host_fail };
    const PanoscopeParamValue params[] = { { .kind = PANOSCOPE_PARAM_FLOAT, .float_value = 2.0 } };
    uint8_t pixels[] = { 0, 10, 20, 100, 200, 255 };
    const uint8_t expected[] = { 0, 20, 40, 200, 255, 255 };
    const PanoscopeFrame input = { .buffer = { .pool = 1 }, .data = pixels, .len = sizeof pixels,
                                   .format = PANOSCOPE_FORMAT_BGR8, .width = 2, .height = 1, .stride_bytes = 6 };
    const PanoscopePortRange range = { .first = 0, .count = 1 };
    Call state = { 0 };

    void *instance = NULL;
    PanoscopeOpenCall open = { .struct_size = sizeof open, .host = &host, .call = &state, .node_id = PANOSCOPE_STR("test"),
                               .params = params, .params_len = 1, .outputs_read = 1 };
    if (type->open(&open, &instance) != PANOSCOPE_STATUS_OK) {
        return wrong("the node does not open");
    }
    PanoscopeCall call = { .struct_size = sizeof call, .host = &host, .call = &state, .inputs = &input, .inputs_len = 1,
                           .input_ranges = &range, .input_ranges_len = 1, .outputs = &state.output, .outputs_len = 1,
                           .params = params, .params_len = 1, .outputs_read = 1 };
    if (type->process(instance, &call) != PANOSCOPE_STATUS_OK) {
        return wrong("the node does not process");
    }
    type->close(instance);
    if (state.output.len != sizeof expected || memcmp(state.output.data, expected, sizeof expected) != 0) {
        return wrong("the picture is not as expected");
    }
    free(state.output.data);
    puts("ok");
    return 0;
}
