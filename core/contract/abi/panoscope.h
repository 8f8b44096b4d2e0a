/*
 * The binary contract between the Panoscope host and its plugins.
 *
 * Made from core/contract/abi by its test `header` (PANOSCOPE_BLESS=1 renews it): do not edit. Only plain data crosses; texts are
 * UTF-8 with a length; fields are only ever appended, and structs that may grow open with their own size.
 * A plugin exports `const PanoscopePlugin *panoscope_plugin(void)` and carries a PANOSCOPE_NOTE.
 * Build: cc -shared -fPIC -fvisibility=hidden, for C++ also -fno-gnu-unique.
 */

#ifndef PANOSCOPE_H
#define PANOSCOPE_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define PANOSCOPE_ALIGNED(BYTES) __attribute__((aligned(BYTES)))

/**
 * Opens every descriptor: the bytes `PANOSCOP`, little-endian.
 */
#define PANOSCOPE_MAGIC 5786918071286251856

/**
 * Plugins of another major version are refused.
 */
#define PANOSCOPE_ABI_MAJOR 1

/**
 * Grows when fields, flags or host functions are appended, or a reserved field gets a name.
 */
#define PANOSCOPE_ABI_MINOR 6

/**
 * Set in PanoscopeCall.flags in `batch` mode.
 */
#define PANOSCOPE_CALL_BATCH 1

/**
 * Set in PanoscopeValidateCall.flags when `connections` and `outputs_read` are known.
 */
#define PANOSCOPE_CALL_WIRED 2

/**
 * In PanoscopeValidateCall.invalid: the node cannot open, or no tick of it can succeed.
 */
#define PANOSCOPE_PROBLEM_ERROR 1

/**
 * In PanoscopeValidateCall.invalid: the node works, but probably not as intended.
 */
#define PANOSCOPE_PROBLEM_WARNING 2

/**
 * In PanoscopeValidateCall.invalid: the problem concerns the whole node, not one parameter.
 */
#define PANOSCOPE_NO_PARAM 4294967295

/**
 * Errors that stop a node.
 */
#define PANOSCOPE_LOG_ERROR 1

/**
 * Something a user should know.
 */
#define PANOSCOPE_LOG_WARN 2

/**
 * Progress.
 */
#define PANOSCOPE_LOG_INFO 3

/**
 * Details for debugging the node.
 */
#define PANOSCOPE_LOG_DEBUG 4

/**
 * For PanoscopeHost.arrived_ns and PanoscopeHost.age_ns: the tick of the call, whatever its inputs are.
 */
#define PANOSCOPE_INPUT_TICK 4294967295

/**
 * The node is going to write the file: no other node may.
 */
#define PANOSCOPE_CLAIM_HOLD 0

/**
 * The node begins to write: the returned file may be created or truncated. One of an earlier run is replaced.
 */
#define PANOSCOPE_CLAIM_BEGIN 1

/**
 * As PANOSCOPE_CLAIM_BEGIN, but the returned path never exists yet.
 */
#define PANOSCOPE_CLAIM_BEGIN_NEW 2

/**
 * Short calculation, runs on the shared pool or inline after its producer.
 */
#define PANOSCOPE_KIND_COMPUTE 0

/**
 * May wait (grab, inference, encode, serial): owns a thread.
 */
#define PANOSCOPE_KIND_BLOCKING 1

/**
 * Control loop: owns a thread with real-time priority where the system allows it.
 */
#define PANOSCOPE_KIND_REALTIME 2

/**
 * The node makes ticks: it runs without waiting for any input.
 */
#define PANOSCOPE_NODE_SOURCE 1

/**
 * The node owns a device: two instances cannot be open at once.
 */
#define PANOSCOPE_NODE_EXCLUSIVE 2

/**
 * The node acts on the world outside the graph (writes files, moves an arm).
 */
#define PANOSCOPE_NODE_SIDE_EFFECTS 4

/**
 * The node calls PanoscopeHost.fetch before it reads a frame of PANOSCOPE_HOME_DEVICE. For other nodes the host fetches
 * all inputs before each call. Since `ABI_MINOR` 6.
 */
#define PANOSCOPE_NODE_FETCHES 8

/**
 * The input may stay unconnected, and may be empty for a tick.
 */
#define PANOSCOPE_PORT_OPTIONAL 1

/**
 * The input takes any number of frames.
 */
#define PANOSCOPE_PORT_LIST 2

/**
 * `true` or `false`.
 */
#define PANOSCOPE_PARAM_BOOL 1

/**
 * A whole number.
 */
#define PANOSCOPE_PARAM_INT 2

/**
 * A number.
 */
#define PANOSCOPE_PARAM_FLOAT 3

/**
 * One of a fixed list of names.
 */
#define PANOSCOPE_PARAM_CHOICE 4

/**
 * Any text.
 */
#define PANOSCOPE_PARAM_TEXT 5

/**
 * A file or folder, relative to the graph file.
 */
#define PANOSCOPE_PARAM_PATH 6

/**
 * A list of numbers.
 */
#define PANOSCOPE_PARAM_FLOATS 7

/**
 * A change closes the node and reopens it.
 */
#define PANOSCOPE_PARAM_REOPEN 1

/**
 * The file named by the path must exist when the graph is checked.
 */
#define PANOSCOPE_PARAM_MUST_EXIST 2

/**
 * The numbers are points of an image in px: u, v, u, v, ... The image is the first one that the node reads, or the
 * first one that a source makes.
 */
#define PANOSCOPE_PARAM_POINTS 4

/**
 * The numbers are rectangles of an image in px: x, y, width, height, ... The image is as for points.
 */
#define PANOSCOPE_PARAM_RECTANGLES 8

/**
 * The text may name a file or folder, relative to the graph file.
 */
#define PANOSCOPE_PARAM_FILE 16

/**
 * The node writes the file that the path names; the path may hold placeholders such as `{seq}`.
 */
#define PANOSCOPE_PARAM_WRITES 32

/**
 * The default of the path names a file that comes with the plugin: relative to the folder next to the plugin's library
 * that has the plugin's name, not to the graph file.
 */
#define PANOSCOPE_PARAM_SHIPPED 64

/**
 * Writes `data` into buffer `handle`, from byte `offset` on. `offset` is a multiple of 4.
 */
#define PANOSCOPE_DEVICE_WRITE 1

/**
 * Runs kernel `handle` on `buffers` in `groups` workgroups.
 */
#define PANOSCOPE_DEVICE_RUN 2

/**
 * In PanoscopeBufferId.home: the content is at PanoscopeFrame.data.
 */
#define PANOSCOPE_HOME_HOST 0

/**
 * In PanoscopeBufferId.home: the content may be in the memory of the GPU alone. Before reading PanoscopeFrame.data a node calls
 * PanoscopeHost.fetch. Only nodes with PANOSCOPE_NODE_FETCHES get such frames.
 */
#define PANOSCOPE_HOME_DEVICE 1

/**
 * Payload is raw bytes or plain data of the port's packet type.
 */
#define PANOSCOPE_FORMAT_BYTES 0

/**
 * One byte per pixel.
 */
#define PANOSCOPE_FORMAT_GRAY8 1

/**
 * Three bytes per pixel in the order blue, green, red.
 */
#define PANOSCOPE_FORMAT_BGR8 2

/**
 * Four bytes per pixel in the order red, green, blue, alpha.
 */
#define PANOSCOPE_FORMAT_RGBA8 3

/**
 * One 16-bit unsigned number per pixel.
 */
#define PANOSCOPE_FORMAT_GRAY16 4

/**
 * One 32-bit float per pixel.
 */
#define PANOSCOPE_FORMAT_F32 5

/**
 * Sixteen bytes per point, see PanoscopeCloudPoint.
 */
#define PANOSCOPE_FORMAT_CLOUD 6

/**
 * Type number of the ELF note.
 */
#define PANOSCOPE_NOTE_TYPE 1

/**
 * Bytes for the plugin's name.
 */
#define PANOSCOPE_NOTE_NAME_LEN 64

/**
 * Bytes for the plugin's version.
 */
#define PANOSCOPE_NOTE_VERSION_LEN 32

/**
 * Bytes for the node types' names, separated by commas.
 */
#define PANOSCOPE_NOTE_NODES_LEN 2048

/**
 * The registration was found on this tick.
 */
#define PANOSCOPE_STATE_FRESH 0

/**
 * The registration of an earlier tick is still in use.
 */
#define PANOSCOPE_STATE_HELD 1

/**
 * No registration to rely on.
 */
#define PANOSCOPE_STATE_LOST 2

/**
 * Maximum number of joints a PanoscopeJoints packet holds.
 */
#define PANOSCOPE_MAX_JOINTS 8

/**
 * Result of a call into a plugin.
 */
typedef int32_t PanoscopeStatus;

/**
 * Names a buffer of the host without an address, so that it means the same in another process.
 */
typedef struct PanoscopeBufferId {
    /**
     * Pool number; 0 means no buffer.
     */
    uint32_t pool;
    /**
     * Where its content is, a `PANOSCOPE_HOME_` constant.
     */
    uint32_t home;
    /**
     * Byte offset of the buffer in its pool.
     */
    uint64_t offset;
} PanoscopeBufferId;

/**
 * One camera in OpenCV's model.
 */
typedef struct PanoscopeCamera {
    /**
     * Image width in px.
     */
    uint32_t width;
    /**
     * Image height in px.
     */
    uint32_t height;
    /**
     * Focal length in px, horizontal.
     */
    double fx;
    /**
     * Focal length in px, vertical.
     */
    double fy;
    /**
     * Principal point in px, horizontal.
     */
    double cx;
    /**
     * Principal point in px, vertical.
     */
    double cy;
    /**
     * k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y. A tau_x of 1e6 marks an equidistant lens (Kannala
     * and Brandt; OpenCV's `fisheye`), whose k1, k2, k3, k4 come first; all others are 0.
     */
    double distortion[14];
} PanoscopeCamera;

/**
 * Packet `calibration`: both cameras and their rectification.
 */
typedef struct PanoscopeCalibration {
    /**
     * Left camera.
     */
    struct PanoscopeCamera left;
    /**
     * Right camera.
     */
    struct PanoscopeCamera right;
    /**
     * Rotation from the left camera's frame to the right one's, row-major 3x3.
     */
    double right_from_left_rotation[9];
    /**
     * Translation from the left camera's frame to the right one's in mm.
     */
    double right_from_left_mm[3];
    /**
     * Rotation from the left camera's frame to the rectified one, row-major 3x3.
     */
    double rectified_from_left[9];
    /**
     * Rotation from the right camera's frame to the rectified one, row-major 3x3.
     */
    double rectified_from_right[9];
    /**
     * Projection of the rectified left view, row-major 3x4.
     */
    double left_projection[12];
    /**
     * Projection of the rectified right view, row-major 3x4.
     */
    double right_projection[12];
    /**
     * Distance of the camera centres in mm.
     */
    double baseline_mm;
    /**
     * Reprojection error of the calibration in px; NaN when unknown.
     */
    double rms_px;
    /**
     * 1 when the views that this calibration describes are rectified already.
     */
    uint32_t is_rectified;
    /**
     * What the calibration states of its own error, 0 when it states nothing: four bytes from the lowest on, each 0 or
     * `0.001 * 2^((byte - 1) / 18)`. Standard deviations: of the offset of all disparities, px; of all lengths at one
     * depth, percent; of each disparity beside these, px. The fourth is that depth, in m: there the offset of disparities
     * changes no length. Since `ABI_MINOR` 5.
     */
    uint32_t stated_error;
} PanoscopeCalibration;

/**
 * Identity and time of the data that one source call made.
 *
 * All ports of one source call share it. `capture_ns` is media time: deterministic and visible to nodes.
 */
typedef struct PanoscopeTick {
    /**
     * Which source of the graph.
     */
    uint32_t source;
    /**
     * Lag of the packet's light behind that of its tick: of the oldest light in the upper 20 bits, of the newest in
     * the lower 12. Both are rounded up to 10 us and have a 5-bit exponent above their digits. The host sets it; see
     * PanoscopeHost.set_lag_ns.
     */
    uint32_t flags;
    /**
     * Counts the source's calls from 0.
     */
    uint64_t seq;
    /**
     * Media time of the capture in nanoseconds.
     */
    int64_t capture_ns;
} PanoscopeTick;

/**
 * One packet as a node sees it: a borrowed buffer and the layout of its content.
 */
typedef struct PanoscopeFrame {
    /**
     * The buffer; `pool` 0 means that the port is empty for this tick.
     */
    struct PanoscopeBufferId buffer;
    /**
     * First byte of the payload; valid during the call. See PanoscopeBufferId.home.
     */
    uint8_t *data;
    /**
     * Bytes in use.
     */
    size_t len;
    /**
     * One of the `PANOSCOPE_FORMAT_` constants.
     */
    uint32_t format;
    /**
     * Columns in pixels; for plain data 0.
     */
    uint32_t width;
    /**
     * Rows; for plain data 0.
     */
    uint32_t height;
    /**
     * Bytes from one row's start to the next one's.
     */
    uint32_t stride_bytes;
    /**
     * The tick whose data this is.
     */
    struct PanoscopeTick tick;
} PanoscopeFrame;

/**
 * One chunk of a PanoscopeHost.parallel_for loop. Must not unwind.
 */
typedef void (*PanoscopeChunkFn)(void *data, size_t chunk);

/**
 * UTF-8 text owned by its creator; `ptr` may be null when `len` is 0.
 */
typedef struct PanoscopeStr {
    /**
     * First byte.
     */
    const uint8_t *ptr;
    /**
     * Length in bytes.
     */
    size_t len;
} PanoscopeStr;

/**
 * One step of PanoscopeDevice.submit.
 */
typedef struct PanoscopeDeviceStep {
    /**
     * One of the `PANOSCOPE_DEVICE_` constants.
     */
    uint32_t kind;
    /**
     * Workgroups in x and y.
     */
    uint32_t groups[2];
    /**
     * Reserved, 0.
     */
    uint32_t reserved;
    /**
     * The kernel that runs or the buffer that is written.
     */
    uint64_t handle;
    /**
     * First byte that is written.
     */
    uint64_t offset;
    /**
     * Buffers of the kernel: binding `i` of group 0 is `buffers[i]`.
     */
    const uint64_t *buffers;
    /**
     * Count of `buffers`.
     */
    size_t buffers_len;
    /**
     * Bytes to write; read before `submit` returns.
     */
    const uint8_t *data;
    /**
     * Count of `data`.
     */
    size_t data_len;
} PanoscopeDeviceStep;

/**
 * The GPU of a process: buffers in its memory and kernels that compute on them. Kernels and buffers are numbers above
 * 0. All functions may be called from any thread. What threads submit runs in the order of the calls.
 */
typedef struct PanoscopeDevice {
    /**
     * Size of this struct in bytes.
     */
    uint32_t struct_size;
    /**
     * Reserved, 0.
     */
    uint32_t reserved;
    /**
     * Name of the device, as its driver gives it.
     */
    struct PanoscopeStr name;
    /**
     * Handle for the functions.
     */
    void *ctx;
    /**
     * Maximum number of bytes of a buffer.
     */
    uint64_t max_buffer_bytes;
    /**
     * Compiles a compute shader in WGSL with the entry point `main`, whose bindings are storage buffers of group 0. 0
     * when that fails.
     */
    uint64_t (*kernel)(void *ctx, struct PanoscopeStr label, struct PanoscopeStr source);
    /**
     * Makes a buffer of at least `bytes` bytes whose content is unspecified. 0 when that fails.
     */
    uint64_t (*buffer)(void *ctx, uint64_t bytes);
    /**
     * Gives a kernel or a buffer back. Work that was submitted still has it.
     */
    void (*free)(void *ctx, uint64_t handle);
    /**
     * Queues steps in their order and returns without waiting for them.
     */
    PanoscopeStatus (*submit)(void *ctx, const struct PanoscopeDeviceStep *steps, size_t len);
    /**
     * Waits for the work submitted so far and copies bytes of a buffer, from `offset` on, to `to`. `offset` is a
     * multiple of 4.
     */
    PanoscopeStatus (*read)(void *ctx, uint64_t buffer, uint64_t offset, uint8_t *to, size_t len);
    /**
     * Why the last function that failed on this thread did; valid until the next one fails.
     */
    struct PanoscopeStr (*failure)(void *ctx);
} PanoscopeDevice;

/**
 * Functions of the host. One table per plugin; valid until the process ends.
 *
 * Functions that take a `call` expect the handle of the running PanoscopeCall or PanoscopeOpenCall.
 */
typedef struct PanoscopeHost {
    /**
     * Size of this struct in bytes: functions past it do not exist in this host.
     */
    uint32_t struct_size;
    /**
     * PANOSCOPE_ABI_MAJOR of the host.
     */
    uint32_t abi_major;
    /**
     * PANOSCOPE_ABI_MINOR of the host.
     */
    uint32_t abi_minor;
    /**
     * Threads of the host's pool.
     */
    uint32_t threads;
    /**
     * Handle for `parallel_for`, `retain`, `release` and `resolve`.
     */
    void *ctx;
    /**
     * Makes output `output` of the running call: a buffer of `len` bytes, described by the other arguments. Contents
     * are unspecified.
     */
    PanoscopeStatus (*alloc)(void *call,
                             uint32_t output,
                             uint32_t format,
                             uint32_t width,
                             uint32_t height,
                             uint32_t stride_bytes,
                             size_t len);
    /**
     * Makes output `output` the same buffer as `frame` (an input of this call, or a retained frame). Nothing is
     * copied.
     */
    PanoscopeStatus (*forward)(void *call, uint32_t output, const struct PanoscopeFrame *frame);
    /**
     * Makes sure that output `output` is shared with nobody, by a counted copy if need be, so that it may be written.
     */
    PanoscopeStatus (*make_mut)(void *call, uint32_t output);
    /**
     * Keeps a buffer beyond the call.
     */
    void (*retain)(void *ctx, struct PanoscopeBufferId buffer);
    /**
     * Gives a kept buffer back.
     */
    void (*release)(void *ctx, struct PanoscopeBufferId buffer);
    /**
     * Address of a buffer that the caller holds; null when there is no such buffer.
     */
    uint8_t *(*resolve)(void *ctx, struct PanoscopeBufferId buffer);
    /**
     * Runs `body(data, i)` for `i` in `0..chunks` on the host's pool; the caller takes part.
     */
    PanoscopeStatus (*parallel_for)(void *ctx, size_t chunks, PanoscopeChunkFn body, void *data);
    /**
     * A line for the host's log, with the node's name added by the host.
     */
    void (*log)(void *call, uint32_t level, struct PanoscopeStr message);
    /**
     * Reports the message of a fault. With `PANOSCOPE_STATUS_ERROR` or `PANOSCOPE_STATUS_PANIC` it says why the call failed; with
     * `PANOSCOPE_STATUS_END`, why the source ended too early; with `PANOSCOPE_STATUS_OK`, the reported problem, although the node
     * continues. Each call counts as one fault of the node.
     */
    void (*fail)(void *call, struct PanoscopeStr message);
    /**
     * A named number of the node, shown next to its timing.
     */
    void (*metric)(void *call, struct PanoscopeStr name, double value);
    /**
     * The next number of a generator seeded by node and tick: the same in every run.
     */
    uint64_t (*random)(void *call);
    /**
     * Takes bytes of PanoscopeNodeType.save_state.
     */
    void (*save)(void *sink, const uint8_t *bytes, size_t len);
    /**
     * Claims a file that the node writes, for as long as the instance is open. `action` is a `CLAIM_` constant.
     * `file`, which may be null, is set to a text that is valid until the call ends. With `PANOSCOPE_STATUS_OK` that is the path
     * to write. For PANOSCOPE_CLAIM_HOLD it is the same in the whole run; otherwise it is `path` itself the first time in a
     * run, later `name.part2.extension` and so on, so that nothing written in this run is cut off. With
     * `PANOSCOPE_STATUS_INVALID` it is the name of the open node that writes the file, with `PANOSCOPE_STATUS_ERROR` a message: another
     * run writes it.
     */
    PanoscopeStatus (*claim_file)(void *call, struct PanoscopeStr path, uint32_t action, struct PanoscopeStr *file);
    /**
     * The host's monotonic clock in ns: for nodes that note when something happened. What a node makes must not depend
     * on it.
     */
    int64_t (*clock_ns)(void *call);
    /**
     * For a source: when the light (or the packet) of this tick arrived, by the clock of PanoscopeHost.clock_ns. All ages
     * count from there. A time in the future counts as now. Without this call a tick arrives when it enters the graph.
     */
    void (*set_arrived_ns)(void *call, int64_t arrived_ns);
    /**
     * When the light of an input frame arrived, by the clock of PanoscopeHost.clock_ns; `input` is an index into
     * PanoscopeCall.inputs or PANOSCOPE_INPUT_TICK. For times between two arrivals. Where results must not depend on the wall
     * clock (`batch`), the capture time. A replay returns what the recorded run returned. `INT64_MIN` for an empty
     * frame and where the time is unknown.
     */
    int64_t (*arrived_ns)(void *call, uint32_t input);
    /**
     * Age of the light of an input frame: the time from PanoscopeHost.arrived_ns to this call. All answers during one call
     * are for the same moment; in `batch` that is the capture time of the tick. `INT64_MAX` where `arrived_ns` is
     * `INT64_MIN`.
     */
    int64_t (*age_ns)(void *call, uint32_t input);
    /**
     * Declares that the outputs of this call show light older than the tick's by this many ns (held or predicted
     * values). Readers see this age. An output never looks younger than the oldest input. A source uses
     * PanoscopeHost.set_arrived_ns.
     */
    void (*set_lag_ns)(void *call, int64_t lag_ns);
    /**
     * The GPU of this process, opened by the first call. Null when there is none: `reason` then says why.
     */
    const struct PanoscopeDevice *(*device)(void *ctx, struct PanoscopeStr *reason);
    /**
     * The buffer on the GPU with the content of a frame that the caller holds. The content is copied there when it is
     * not there yet, and the copy is counted. The buffer is lent as long as the frame is held, for reading alone. 0 when
     * that fails, see PanoscopeDevice.failure.
     */
    uint64_t (*device_buffer)(void *ctx, const struct PanoscopeFrame *frame);
    /**
     * As PanoscopeHost.alloc, with the content on the GPU: the node writes into `buffer`, which is lent as long as the
     * frame is held.
     */
    PanoscopeStatus (*alloc_on_device)(void *call,
                                       uint32_t output,
                                       uint32_t format,
                                       uint32_t width,
                                       uint32_t height,
                                       uint32_t stride_bytes,
                                       size_t len,
                                       uint64_t *buffer);
    /**
     * Makes sure that the content of a frame that the caller holds is at PanoscopeFrame.data. A copy from the GPU is
     * counted. When that fails, the content is black or NaN and the run reports it.
     */
    PanoscopeStatus (*fetch)(void *ctx, const struct PanoscopeFrame *frame);
} PanoscopeHost;

/**
 * Which of the flattened PanoscopeCall.inputs belong to one input port.
 */
typedef struct PanoscopePortRange {
    /**
     * Index of the first frame.
     */
    uint32_t first;
    /**
     * Number of frames; 1 except for list ports.
     */
    uint32_t count;
} PanoscopePortRange;

/**
 * A parameter's value at a point in time.
 */
typedef struct PanoscopeParamValue {
    /**
     * One of the `PANOSCOPE_PARAM_` constants.
     */
    uint32_t kind;
    /**
     * The chosen entry of a `PANOSCOPE_PARAM_CHOICE`.
     */
    uint32_t index;
    /**
     * `PANOSCOPE_PARAM_BOOL` (0 or 1) and `PANOSCOPE_PARAM_INT`.
     */
    int64_t int_value;
    /**
     * `PANOSCOPE_PARAM_FLOAT`.
     */
    double float_value;
    /**
     * `PANOSCOPE_PARAM_TEXT`, `PANOSCOPE_PARAM_PATH` (absolute) and the name of a `PANOSCOPE_PARAM_CHOICE`.
     */
    struct PanoscopeStr text;
    /**
     * `PANOSCOPE_PARAM_FLOATS`.
     */
    const double *floats;
    /**
     * Count of `floats`.
     */
    size_t floats_len;
} PanoscopeParamValue;

/**
 * Arguments of PanoscopeNodeType.process.
 */
typedef struct PanoscopeCall {
    /**
     * Size of this struct in bytes.
     */
    uint32_t struct_size;
    /**
     * `PANOSCOPE_CALL_` bits.
     */
    uint32_t flags;
    /**
     * The host's functions.
     */
    const struct PanoscopeHost *host;
    /**
     * Handle for host functions that take a `call`.
     */
    void *call;
    /**
     * The tick being processed. A source may set `capture_ns`; the host numbers it.
     */
    struct PanoscopeTick tick;
    /**
     * All input frames, flattened; `input_ranges` says which belong to which port.
     */
    const struct PanoscopeFrame *inputs;
    /**
     * Count of `inputs`.
     */
    size_t inputs_len;
    /**
     * One range per declared input port.
     */
    const struct PanoscopePortRange *input_ranges;
    /**
     * Count of `input_ranges`.
     */
    size_t input_ranges_len;
    /**
     * One frame per declared output port, empty at the start of the call; filled by PanoscopeHost.alloc and
     * PanoscopeHost.forward.
     */
    struct PanoscopeFrame *outputs;
    /**
     * Count of `outputs`.
     */
    size_t outputs_len;
    /**
     * Values in the order of the type's declaration.
     */
    const struct PanoscopeParamValue *params;
    /**
     * Count of `params`.
     */
    size_t params_len;
    /**
     * Changes whenever `params` change.
     */
    uint64_t params_version;
    /**
     * Bit `i` is set when output `i` has a reader (outputs above 63 count as read).
     */
    uint64_t outputs_read;
} PanoscopeCall;

/**
 * One point of a `cloud`, whose frame is `width` x `height` points; NaN coordinates mean unknown.
 */
typedef struct PanoscopeCloudPoint {
    /**
     * Right, mm.
     */
    float x_mm;
    /**
     * Down, mm.
     */
    float y_mm;
    /**
     * Forward, mm.
     */
    float z_mm;
    /**
     * Blue, green, red.
     */
    uint8_t bgr[3];
    /**
     * 0 where the point was measured, 1 where it was filled in from the points around it: such a point is shown as a
     * guess, and no length is taken from it. Older plugins and recordings have 0 in all points. Since `ABI_MINOR` 4.
     */
    uint8_t filled;
} PanoscopeCloudPoint;

/**
 * One entry of `detections`. The packet is PanoscopeDetectionsHeader, the entries, then the label text.
 */
typedef struct PanoscopeDetection {
    /**
     * Left edge in px.
     */
    float x_px;
    /**
     * Upper edge in px.
     */
    float y_px;
    /**
     * Width in px.
     */
    float width_px;
    /**
     * Height in px.
     */
    float height_px;
    /**
     * 0..1.
     */
    float score;
    /**
     * Index into the label table.
     */
    uint32_t class_index;
    /**
     * Stays with the object over time; -1 when not tracked.
     */
    int64_t track_id;
} PanoscopeDetection;

/**
 * Opens a `detections` or `instances` packet.
 */
typedef struct PanoscopeDetectionsHeader {
    /**
     * Number of PanoscopeDetections that follow.
     */
    uint32_t count;
    /**
     * Bytes of label text (names separated by line feeds) after the entries.
     */
    uint32_t labels_len;
    /**
     * Width in px of the image that was searched.
     */
    uint32_t image_width;
    /**
     * Height in px of the image that was searched.
     */
    uint32_t image_height;
    /**
     * `instances` only: bytes of bit masks after the label text. Per entry a mask of the whole image, rows padded to
     * whole bytes, most significant bit first.
     */
    uint64_t masks_len;
} PanoscopeDetectionsHeader;

/**
 * An input or output of a node type.
 */
typedef struct PanoscopePort {
    /**
     * Name in graph files.
     */
    struct PanoscopeStr name;
    /**
     * Description of the data, for users.
     */
    struct PanoscopeStr doc;
    /**
     * Name of the packet type: `image`, `disparity`, ... or a plugin's own.
     */
    struct PanoscopeStr packet;
    /**
     * Hash of the packet's memory layout; 0 for types without fixed layout.
     */
    uint64_t layout_hash;
    /**
     * Bit set of formats that an input takes or an output may make; 0 for plain data.
     */
    uint32_t formats;
    /**
     * `PANOSCOPE_PORT_` bits.
     */
    uint32_t flags;
} PanoscopePort;

/**
 * A parameter of a node type.
 */
typedef struct PanoscopeParam {
    /**
     * Name in graph files.
     */
    struct PanoscopeStr name;
    /**
     * Description of its effect, for users.
     */
    struct PanoscopeStr doc;
    /**
     * Unit such as `px`, `mm`, `ms`; empty for none.
     */
    struct PanoscopeStr unit;
    /**
     * One of the `PANOSCOPE_PARAM_` kinds.
     */
    uint32_t kind;
    /**
     * `PANOSCOPE_PARAM_REOPEN`, `PANOSCOPE_PARAM_MUST_EXIST`, `PANOSCOPE_PARAM_POINTS`, `PANOSCOPE_PARAM_RECTANGLES`, `PANOSCOPE_PARAM_FILE`, `PANOSCOPE_PARAM_WRITES`,
     * `PANOSCOPE_PARAM_SHIPPED`.
     */
    uint32_t flags;
    /**
     * Default of `PANOSCOPE_PARAM_BOOL`, `PANOSCOPE_PARAM_INT`, `PANOSCOPE_PARAM_FLOAT`; index of the default `PANOSCOPE_PARAM_CHOICE`.
     */
    double default_number;
    /**
     * Smallest value of `PANOSCOPE_PARAM_INT` and `PANOSCOPE_PARAM_FLOAT`; fewest entries of `PANOSCOPE_PARAM_FLOATS`.
     */
    double min;
    /**
     * Largest value of `PANOSCOPE_PARAM_INT` and `PANOSCOPE_PARAM_FLOAT`; most entries of `PANOSCOPE_PARAM_FLOATS`.
     */
    double max;
    /**
     * Distance of neighbouring values; 0 when any value is fine.
     */
    double step;
    /**
     * Default of `PANOSCOPE_PARAM_TEXT` and `PANOSCOPE_PARAM_PATH`.
     */
    struct PanoscopeStr default_text;
    /**
     * Names of the entries of a `PANOSCOPE_PARAM_CHOICE`.
     */
    const struct PanoscopeStr *choices;
    /**
     * Count of `choices`.
     */
    size_t choices_len;
    /**
     * Default of `PANOSCOPE_PARAM_FLOATS`.
     */
    const double *default_floats;
    /**
     * Count of `default_floats`.
     */
    size_t default_floats_len;
} PanoscopeParam;

/**
 * Arguments of PanoscopeNodeType.open.
 */
typedef struct PanoscopeOpenCall {
    /**
     * Size of this struct in bytes.
     */
    uint32_t struct_size;
    /**
     * `PANOSCOPE_CALL_` bits.
     */
    uint32_t flags;
    /**
     * The host's functions; the same for the life of the plugin.
     */
    const struct PanoscopeHost *host;
    /**
     * Handle for host functions that take a `call`.
     */
    void *call;
    /**
     * The node's name in the graph.
     */
    struct PanoscopeStr node_id;
    /**
     * Values in the order of the type's declaration.
     */
    const struct PanoscopeParamValue *params;
    /**
     * Count of `params`.
     */
    size_t params_len;
    /**
     * Folder of the graph file, absolute.
     */
    struct PanoscopeStr graph_dir;
    /**
     * Bit `i` is set when output `i` has a reader (outputs above 63 count as read).
     */
    uint64_t outputs_read;
} PanoscopeOpenCall;

/**
 * Arguments of PanoscopeNodeType.validate.
 */
typedef struct PanoscopeValidateCall {
    /**
     * Size of this struct in bytes.
     */
    uint32_t struct_size;
    /**
     * `PANOSCOPE_CALL_` bits.
     */
    uint32_t flags;
    /**
     * Handle for `invalid`.
     */
    void *call;
    /**
     * The node's name in the graph.
     */
    struct PanoscopeStr node_id;
    /**
     * Values in the order of the type's declaration.
     */
    const struct PanoscopeParamValue *params;
    /**
     * Count of `params`.
     */
    size_t params_len;
    /**
     * Folder of the graph file, absolute.
     */
    struct PanoscopeStr graph_dir;
    /**
     * Number of connections of each declared input.
     */
    const uint32_t *connections;
    /**
     * Count of `connections`; 0 without PANOSCOPE_CALL_WIRED.
     */
    size_t connections_len;
    /**
     * Bit `i` is set when output `i` has a reader (outputs above 63 count as read).
     */
    uint64_t outputs_read;
    /**
     * Takes one problem: a `PANOSCOPE_PROBLEM_` severity, the position of the parameter it is about (or PANOSCOPE_NO_PARAM), what is
     * wrong in one sentence, and what to do about it (may be empty). Texts are copied.
     */
    void (*invalid)(void *call, uint32_t severity, uint32_t param, struct PanoscopeStr message, struct PanoscopeStr help);
} PanoscopeValidateCall;

/**
 * A node type that a plugin offers.
 */
typedef struct PanoscopeNodeType {
    /**
     * Size of this struct in bytes.
     */
    uint32_t struct_size;
    /**
     * One of the `PANOSCOPE_KIND_` constants.
     */
    uint32_t kind;
    /**
     * `PANOSCOPE_NODE_` bits.
     */
    uint32_t flags;
    /**
     * Reserved, 0.
     */
    uint32_t reserved;
    /**
     * Name in graph files.
     */
    struct PanoscopeStr name;
    /**
     * Family: source, stereo, stitch, tools, arm, overlay, sink, filter.
     */
    struct PanoscopeStr family;
    /**
     * Description of the node, for users.
     */
    struct PanoscopeStr doc;
    /**
     * Input ports.
     */
    const struct PanoscopePort *inputs;
    /**
     * Count of `inputs`.
     */
    size_t inputs_len;
    /**
     * Output ports.
     */
    const struct PanoscopePort *outputs;
    /**
     * Count of `outputs`.
     */
    size_t outputs_len;
    /**
     * Parameters.
     */
    const struct PanoscopeParam *params;
    /**
     * Count of `params`.
     */
    size_t params_len;
    /**
     * Makes an instance. May take long; runs off the hot path.
     */
    PanoscopeStatus (*open)(struct PanoscopeOpenCall *open, void **instance);
    /**
     * Processes one tick. One call at a time per instance, from any thread.
     */
    PanoscopeStatus (*process)(void *instance, struct PanoscopeCall *call);
    /**
     * Finishes files, gives back devices and frees the instance.
     */
    void (*close)(void *instance);
    /**
     * Optional: passes the instance's state to PanoscopeHost.save.
     */
    PanoscopeStatus (*save_state)(void *instance, const struct PanoscopeHost *host, void *sink);
    /**
     * Optional: takes the bytes that an earlier instance saved.
     */
    PanoscopeStatus (*load_state)(void *instance, const uint8_t *bytes, size_t len);
    /**
     * Optional: reports to PanoscopeValidateCall.invalid parameters and wiring that PanoscopeNodeType.open or the first tick
     * would refuse. Opens no device, writes nothing and makes no instance; may be called at any time, from any thread.
     * Since `ABI_MINOR` 2.
     */
    PanoscopeStatus (*validate)(struct PanoscopeValidateCall *call);
    /**
     * Optional: completes files before PanoscopeNodeType.close and reports through PanoscopeHost.fail what could not be
     * written. `call` is the handle for host functions that take one. Since `ABI_MINOR` 2.
     */
    PanoscopeStatus (*finish)(void *instance, const struct PanoscopeHost *host, void *call);
} PanoscopeNodeType;

/**
 * Description of a plugin in its ELF file, readable before any of its code runs. Texts are zero-padded.
 */
typedef struct PanoscopeNoteBody {
    /**
     * PANOSCOPE_ABI_MAJOR that the plugin was built with.
     */
    uint32_t abi_major;
    /**
     * PANOSCOPE_ABI_MINOR that the plugin was built with.
     */
    uint32_t abi_minor;
    /**
     * Plugin name.
     */
    uint8_t name[PANOSCOPE_NOTE_NAME_LEN];
    /**
     * Plugin version.
     */
    uint8_t version[PANOSCOPE_NOTE_VERSION_LEN];
    /**
     * Names of the node types, separated by commas.
     */
    uint8_t nodes[PANOSCOPE_NOTE_NODES_LEN];
} PanoscopeNoteBody;

/**
 * An ELF note record.
 */
typedef struct PANOSCOPE_ALIGNED(4) PanoscopeNote {
    /**
     * Length of `owner`.
     */
    uint32_t owner_len;
    /**
     * Length of `body`.
     */
    uint32_t body_len;
    /**
     * PANOSCOPE_NOTE_TYPE.
     */
    uint32_t note_type;
    /**
     * PANOSCOPE_NOTE_OWNER.
     */
    uint8_t owner[12];
    /**
     * Payload of the record.
     */
    struct PanoscopeNoteBody body;
} PanoscopeNote;

/**
 * Descriptor that a plugin exports.
 */
typedef struct PanoscopePlugin {
    /**
     * PANOSCOPE_MAGIC.
     */
    uint64_t magic;
    /**
     * PANOSCOPE_ABI_MAJOR that the plugin was built with.
     */
    uint32_t abi_major;
    /**
     * PANOSCOPE_ABI_MINOR that the plugin was built with.
     */
    uint32_t abi_minor;
    /**
     * Size of this struct in bytes.
     */
    uint32_t struct_size;
    /**
     * Reserved, 0.
     */
    uint32_t reserved;
    /**
     * Name in a graph's `plugins` list.
     */
    struct PanoscopeStr name;
    /**
     * Version for people.
     */
    struct PanoscopeStr version;
    /**
     * Purpose of the plugin.
     */
    struct PanoscopeStr doc;
    /**
     * Node types, one pointer each.
     */
    const struct PanoscopeNodeType *const *node_types;
    /**
     * Count of `node_types`.
     */
    size_t node_types_len;
    /**
     * The note that the ELF file carries; keeps it linked.
     */
    const struct PanoscopeNote *note;
    /**
     * Called once after loading with the host's functions.
     */
    PanoscopeStatus (*attach)(const struct PanoscopeHost *host);
} PanoscopePlugin;

/**
 * Type of PANOSCOPE_ENTRY_SYMBOL.
 */
typedef const struct PanoscopePlugin *(*PanoscopeEntry)(void);

/**
 * Packet `homography`: maps pixels of the right view to pixels of the left view.
 */
typedef struct PanoscopeHomography {
    /**
     * Row-major 3x3.
     */
    double left_from_right[9];
    /**
     * Root mean square distance of the inliers in px.
     */
    double rms_px;
    /**
     * Correspondences that agree.
     */
    uint32_t inliers;
    /**
     * `PANOSCOPE_STATE_FRESH`, `PANOSCOPE_STATE_HELD` or `PANOSCOPE_STATE_LOST`.
     */
    uint32_t state;
} PanoscopeHomography;

/**
 * Packet `joints`.
 */
typedef struct PanoscopeJoints {
    /**
     * Angles in rad.
     */
    double position_rad[PANOSCOPE_MAX_JOINTS];
    /**
     * Speeds in rad/s.
     */
    double velocity_rad_s[PANOSCOPE_MAX_JOINTS];
    /**
     * Joints in use.
     */
    uint32_t count;
    /**
     * Reserved, 0.
     */
    uint32_t reserved;
} PanoscopeJoints;

/**
 * Packet `pose`: position and orientation of frame `b` in frame `a`.
 */
typedef struct PanoscopePose {
    /**
     * Rotation as quaternion w, x, y, z.
     */
    double a_from_b_wxyz[4];
    /**
     * Translation in mm.
     */
    double a_from_b_mm[3];
    /**
     * Name of frame `a`, zero-padded.
     */
    uint8_t a[16];
    /**
     * Name of frame `b`, zero-padded.
     */
    uint8_t b[16];
} PanoscopePose;

/**
 * Packet `roi`: a rectangle in pixels.
 */
typedef struct PanoscopeRoi {
    /**
     * Left edge in px.
     */
    int32_t x;
    /**
     * Upper edge in px.
     */
    int32_t y;
    /**
     * Width in px.
     */
    int32_t width;
    /**
     * Height in px.
     */
    int32_t height;
} PanoscopeRoi;

/**
 * Packet `scalar`: one number with its name and unit.
 */
typedef struct PanoscopeScalar {
    /**
     * The number.
     */
    double value;
    /**
     * Name of the number, zero-padded.
     */
    uint8_t name[32];
    /**
     * Its unit, zero-padded.
     */
    uint8_t unit[16];
} PanoscopeScalar;

/**
 * Opens a `table` packet; then the column text, then `rows * columns` f64 in row order.
 */
typedef struct PanoscopeTableHeader {
    /**
     * Number of rows.
     */
    uint32_t rows;
    /**
     * Number of columns.
     */
    uint32_t columns;
    /**
     * Bytes of column names (with units, separated by line feeds), zero-padded to a multiple of 8.
     */
    uint32_t names_len;
    /**
     * Reserved, 0.
     */
    uint32_t reserved;
} PanoscopeTableHeader;

/**
 * Packet `tip`: the tip of one tool.
 */
typedef struct PanoscopeTip {
    /**
     * Pixel in the left view, horizontal.
     */
    double u_px;
    /**
     * Pixel in the left view, vertical.
     */
    double v_px;
    /**
     * Place in the left rectified camera's frame in mm; NaN when unknown.
     */
    double xyz_mm[3];
    /**
     * 0..1.
     */
    double score;
    /**
     * Index into the label table of the detector.
     */
    uint32_t class_index;
    /**
     * 1 when `xyz_mm` can be relied on.
     */
    uint32_t xyz_valid;
    /**
     * Stays with the tool over time; -1 when not tracked.
     */
    int64_t track_id;
} PanoscopeTip;

/**
 * Done.
 */
#define PANOSCOPE_STATUS_OK 0

/**
 * The source has ended.
 */
#define PANOSCOPE_STATUS_END 1

/**
 * The node failed; its message was passed to PanoscopeHost.fail.
 */
#define PANOSCOPE_STATUS_ERROR (-1)

/**
 * The node panicked or threw; its message was passed to PanoscopeHost.fail.
 */
#define PANOSCOPE_STATUS_PANIC (-2)

/**
 * The host's frame memory is exhausted.
 */
#define PANOSCOPE_STATUS_EXHAUSTED (-3)

/**
 * An argument is malformed (a wrong port number, a size of 0).
 */
#define PANOSCOPE_STATUS_INVALID (-4)

/**
 * The node failed and opening it again would not help (the disk is full): it stays closed until its graph is edited.
 */
#define PANOSCOPE_STATUS_STOPPED (-5)

/** The one symbol that a plugin exports. */
#define PANOSCOPE_ENTRY_SYMBOL "panoscope_plugin"

/** ELF section that holds the note. */
#define PANOSCOPE_NOTE_SECTION ".note.panoscope"

/** Name of the output that tells where the links of an arm join. */
#define PANOSCOPE_LINKS "links"
/** Columns of its table: a row per joint from the base to the camera, in the frame of the node's pose. */
#define PANOSCOPE_LINK_COLUMNS "link_x_mm\nlink_y_mm\nlink_z_mm"

/* The layout that the host was built with, on 64-bit systems. */
#ifdef __cplusplus
#define PANOSCOPE_ASSERT(CONDITION) static_assert(CONDITION, #CONDITION)
#else
#define PANOSCOPE_ASSERT(CONDITION) _Static_assert(CONDITION, #CONDITION)
#endif
PANOSCOPE_ASSERT(sizeof(PanoscopeStr) == 16);
PANOSCOPE_ASSERT(sizeof(PanoscopeTick) == 24);
PANOSCOPE_ASSERT(sizeof(PanoscopeBufferId) == 16);
PANOSCOPE_ASSERT(sizeof(PanoscopeFrame) == 72);
PANOSCOPE_ASSERT(sizeof(PanoscopePortRange) == 8);
PANOSCOPE_ASSERT(sizeof(PanoscopeParamValue) == 56);
PANOSCOPE_ASSERT(sizeof(PanoscopeOpenCall) == 80);
PANOSCOPE_ASSERT(sizeof(PanoscopeValidateCall) == 96);
PANOSCOPE_ASSERT(sizeof(PanoscopeCall) == 128);
PANOSCOPE_ASSERT(sizeof(PanoscopeHost) == 200);
PANOSCOPE_ASSERT(sizeof(PanoscopePort) == 64);
PANOSCOPE_ASSERT(sizeof(PanoscopeParam) == 136);
PANOSCOPE_ASSERT(sizeof(PanoscopeNodeType) == 168);
PANOSCOPE_ASSERT(sizeof(PanoscopePlugin) == 104);
PANOSCOPE_ASSERT(sizeof(PanoscopeNoteBody) == 2152);
PANOSCOPE_ASSERT(sizeof(PanoscopeNote) == 2176);
PANOSCOPE_ASSERT(sizeof(PanoscopeHomography) == 88);
PANOSCOPE_ASSERT(sizeof(PanoscopeRoi) == 16);
PANOSCOPE_ASSERT(sizeof(PanoscopeCamera) == 152);
PANOSCOPE_ASSERT(sizeof(PanoscopeCalibration) == 760);
PANOSCOPE_ASSERT(sizeof(PanoscopeCloudPoint) == 16);
PANOSCOPE_ASSERT(sizeof(PanoscopeDetection) == 32);
PANOSCOPE_ASSERT(sizeof(PanoscopeDetectionsHeader) == 24);
PANOSCOPE_ASSERT(sizeof(PanoscopeTip) == 64);
PANOSCOPE_ASSERT(sizeof(PanoscopePose) == 88);
PANOSCOPE_ASSERT(sizeof(PanoscopeJoints) == 136);
PANOSCOPE_ASSERT(sizeof(PanoscopeScalar) == 56);
PANOSCOPE_ASSERT(sizeof(PanoscopeTableHeader) == 16);

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

#endif  /* PANOSCOPE_H */
