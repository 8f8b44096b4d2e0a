/* ---- Helpers for authors in C and C++, kept by hand in core/contract/abi/src/helpers.h ---- */

/** Bit of a PANOSCOPE_FORMAT_ constant in PanoscopePort.formats. */
#define PANOSCOPE_FORMAT_BIT(FORMAT) (1u << (FORMAT))

/** Initialiser of a PanoscopeStr from a string literal. */
#define PANOSCOPE_STR(LITERAL) { (const uint8_t *)("" LITERAL), sizeof(LITERAL) - 1 }

/** Number of entries of an array. */
#define PANOSCOPE_COUNT(ARRAY) (sizeof(ARRAY) / sizeof((ARRAY)[0]))

/** Goes before the one function that a plugin exports. */
#ifdef __cplusplus
#define PANOSCOPE_EXPORT extern "C" __attribute__((visibility("default")))
#else
#define PANOSCOPE_EXPORT __attribute__((visibility("default")))
#endif

/**
 * Says name, version and node types (separated by commas) in the ELF file, where the host reads them without running any code.
 * Once per plugin, outside of functions; `&panoscope_note` goes into PanoscopePlugin.note.
 */
#define PANOSCOPE_NOTE(NAME, VERSION, NODES)                                                     \
    __attribute__((used, aligned(4), section(PANOSCOPE_NOTE_SECTION))) static const PanoscopeNote panoscope_note = { \
        12, (uint32_t)sizeof(PanoscopeNoteBody), PANOSCOPE_NOTE_TYPE, "Panoscope",               \
        { PANOSCOPE_ABI_MAJOR, PANOSCOPE_ABI_MINOR, NAME, VERSION, NODES }                       \
    }

/** A PanoscopeStr that borrows a zero-terminated text. */
static inline PanoscopeStr panoscope_str(const char *text) {
    PanoscopeStr str;
    str.ptr = (const uint8_t *)text;
    str.len = text ? strlen(text) : 0;
    return str;
}

/** The first frame of input `port`; null when it is empty for this tick. */
static inline const PanoscopeFrame *panoscope_input(const PanoscopeCall *call, uint32_t port) {
    const PanoscopePortRange *range = port < call->input_ranges_len ? &call->input_ranges[port] : NULL;
    const PanoscopeFrame *frame = range && range->count > 0 ? &call->inputs[range->first] : NULL;
    return frame && frame->buffer.pool != 0 ? frame : NULL;
}

/**
 * For a source: the light of this tick arrived at `arrived_ns` by the clock of PanoscopeHost.clock_ns. Nothing happens in a host without arrival
 * times.
 */
static inline void panoscope_set_arrived_ns(PanoscopeCall *call, int64_t arrived_ns) {
    if (call->host->struct_size >= offsetof(PanoscopeHost, set_arrived_ns) + sizeof(void *)) {
        call->host->set_arrived_ns(call->call, arrived_ns);
    }
}

/**
 * Age of the light of the first frame of input `port`, ns; INT64_MAX when it is empty or its age is unknown. In a host without arrival times the
 * difference of capture times.
 */
static inline int64_t panoscope_age_ns(const PanoscopeCall *call, uint32_t port) {
    const PanoscopeFrame *frame = panoscope_input(call, port);
    if (frame == NULL) {
        return INT64_MAX;
    }
    if (call->host->struct_size >= offsetof(PanoscopeHost, age_ns) + sizeof(void *)) {
        return call->host->age_ns(call->call, call->input_ranges[port].first);
    }
    return call->tick.capture_ns - frame->tick.capture_ns;
}

/** Row `y` of an image of bytes. */
static inline uint8_t *panoscope_row(const PanoscopeFrame *frame, uint32_t y) {
    return frame->data + (size_t)y * frame->stride_bytes;
}

/** Makes output `port` an image whose rows have no padding; null when the host refuses. Contents are unspecified. */
static inline PanoscopeFrame *panoscope_alloc_image(PanoscopeCall *call, uint32_t port, uint32_t format, uint32_t width,
                                                    uint32_t height, uint32_t bytes_per_pixel) {
    const size_t stride_bytes = (size_t)width * bytes_per_pixel;
    if (port >= call->outputs_len || stride_bytes > UINT32_MAX) {
        return NULL;
    }
    const PanoscopeStatus status = call->host->alloc(call->call, port, format, width, height, (uint32_t)stride_bytes,
                                                     stride_bytes * height);
    return status == PANOSCOPE_STATUS_OK ? &call->outputs[port] : NULL;
}

/** Gives the host the words of an error; the call then answers what this answers. */
static inline PanoscopeStatus panoscope_fail(const PanoscopeHost *host, void *call, const char *words) {
    host->fail(call, panoscope_str(words));
    return PANOSCOPE_STATUS_ERROR;
}

#ifdef __cplusplus
#include <exception>

/**
 * Opens the body of `open` or `process` in C++: an exception must not leave the plugin. CALL is the function's
 * PanoscopeCall or PanoscopeOpenCall. What is thrown becomes PANOSCOPE_STATUS_PANIC with its words.
 */
#define PANOSCOPE_GUARD_BEGIN(CALL)                                       \
    const PanoscopeHost *const panoscope_guard_host = (CALL)->host;       \
    void *const panoscope_guard_call = (CALL)->call;                      \
    try {
/** Closes the body that PANOSCOPE_GUARD_BEGIN opened. */
#define PANOSCOPE_GUARD_END                                                                        \
    }                                                                                              \
    catch (const std::exception &thrown) {                                                         \
        panoscope_guard_host->fail(panoscope_guard_call, panoscope_str(thrown.what()));            \
        return PANOSCOPE_STATUS_PANIC;                                                             \
    }                                                                                              \
    catch (...) {                                                                                  \
        panoscope_guard_host->fail(panoscope_guard_call, panoscope_str("something was thrown that is no std::exception")); \
        return PANOSCOPE_STATUS_PANIC;                                                             \
    }
#endif
