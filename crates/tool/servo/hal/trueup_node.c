/* The bridge without a board, as a realtime component of LinuxCNC: its pins. What it does is in the library trueup_servo.
 *
 *     loadrt trueup_node file=trueup_calibration.bin joints=XYZ
 *     addf trueup.0 servo-thread
 *
 * file    the calibration, as trueup compile writes it; read when the component is loaded, and refused with the reason
 * joints  a letter for each joint whose drive gets an offset, in the order of their numbers; a dot for any other. Without
 *         it offsets enter as external offsets of the axes
 * rotary  1: angle-1 and angle-2 are given
 * heat    the machine's heat from before a restart; trueup linuxcnc keep writes it while LinuxCNC runs. Without it the
 *         machine counts as cold
 *
 * Pins are those of the component trueup (docs/book/src/linuxcnc.md), and these more:
 *
 *     sensor-v                          the sensor, in volts
 *     temp-NN-in                        temperature of channel NN in degrees Celsius; temp-NN is what the bridge has of it
 *     temp-heartbeat, temp-timeout-ms   a program that gives temperatures turns the first round
 *     sensor-codes-per-v, sensor-resolution-v, mm-per-unit, L-against-um, L-accel, L-keeps-slew, joint-N-min-limit,
 *     joint-N-max-limit                 settings: read once, when the servo thread starts
 *     state, calibration                what the bridge says of itself, and the CRC of its calibration
 */
#include "rtapi.h"
#include "rtapi_app.h"
#include "hal.h"

#include <fcntl.h>
#include <math.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "trueup_servo.h"

MODULE_AUTHOR("the authors of trueup");
MODULE_DESCRIPTION("corrects a machine tool: the trueup bridge without a board");
MODULE_LICENSE("Dual MIT/GPL");

static char *file = "";
RTAPI_MP_STRING(file, "calibration")
static char *joints = "";
RTAPI_MP_STRING(joints, "axis letters of the joints that get an offset")
static char *heat = "";
RTAPI_MP_STRING(heat, "the heat from before a restart")
static int rotary = 0;
RTAPI_MP_INT(rotary, "angles are given")

#define NAME "trueup.0"
#define CONDITIONS 16
/* As on the wire. */
#define NOT_AVAILABLE 6
/* A calibration is 16 KiB at the most. */
#define MAX_CALIBRATION 32768
#define SAY(...) rtapi_print_msg(RTAPI_MSG_ERR, "trueup_node: " __VA_ARGS__)

struct axis {
    hal_float_t *command, *request, *eoffset, *offset_um, *applied_um, *against_um, *accel;
    hal_s32_t *counts;
    hal_bit_t *keeps_slew;
};

struct joint {
    hal_float_t *offset, *min, *max, *now, *command, *reference, *min_limit, *max_limit;
    hal_bit_t *homing;
};

struct pins {
    struct axis axes[3];
    struct joint joints[TRUEUP_JOINTS];
    hal_bit_t *enable, *machine_on, *homed, *zero, *confirm, *temp_heartbeat;
    hal_bit_t *conditions[CONDITIONS];
    hal_float_t *angles[2], *spindle_rpm, *load_n, *sensor_v;
    hal_float_t *temp_in[TRUEUP_TEMPERATURES], *temp[TRUEUP_TEMPERATURES];
    hal_float_t *codes_per_v, *resolution_v, *mm_per_unit, *elongation_um, *scale;
    hal_s32_t *tool, *quality;
    hal_u32_t *flags, *age_ms, *state, *calibration, *pid, *temp_timeout_ms;
    hal_bit_t *applied, *connected, *fault, *limited, *other_calibration, *heartbeat, *enable_out;
};

static int component;
static struct pins *pins;
static int axis_of[TRUEUP_JOINTS];
static uint8_t memory[TRUEUP_SERVO_BYTES] __attribute__((aligned(16)));
static uint8_t calibration[MAX_CALIBRATION];
static size_t length;
/* The heat from before, and where it is saved: in memory that the program trueup linuxcnc keep reads. */
static uint8_t heat_before[TRUEUP_RETAINED_BYTES];
static uint8_t *heat_now;
static const char heat_memory[] = "/dev/shm/trueup_heat";
static time_t loaded_s;
/* What went wrong in the servo thread; it is said once. */
static int32_t refused;
static int started;

static const char LETTERS[] = "xyz", AXES[] = "XYZ";
/* 1 nm, by which an external offset is counted, in mm. */
static const double MM_PER_COUNT = 1e-6;

static void read_settings(struct trueup_settings *to)
{
    memset(to, 0, sizeof *to);
    to->mm_per_unit = *pins->mm_per_unit;
    to->codes_per_v = *pins->codes_per_v;
    to->resolution_v = *pins->resolution_v;
    to->temperature_timeout_ms = *pins->temp_timeout_ms;
    to->sends_rotary = rotary != 0;
    for (int i = 0; i < 3; i++) {
        to->against_um[i] = *pins->axes[i].against_um;
        to->acceleration[i] = *pins->axes[i].accel;
        to->planner_keeps_slew |= (uint32_t)(*pins->axes[i].keeps_slew != 0) << i;
    }
    for (int i = 0; i < TRUEUP_JOINTS; i++) {
        to->joint_axis[i] = axis_of[i];
        if (axis_of[i] < 0) continue;
        to->joint_min[i] = *pins->joints[i].min_limit;
        to->joint_max[i] = *pins->joints[i].max_limit;
    }
}

static void read_inputs(struct trueup_inputs *to)
{
    memset(to, 0, sizeof *to);
    for (int i = 0; i < 3; i++) {
        to->position[i] = *pins->axes[i].command;
        to->request[i] = *pins->axes[i].request;
        to->eoffset[i] = *pins->axes[i].eoffset;
    }
    for (int i = 0; i < 2; i++) to->angles_deg[i] = *pins->angles[i];
    for (int i = 0; i < TRUEUP_TEMPERATURES; i++) to->temperature_c[i] = *pins->temp_in[i];
    for (int i = 0; i < CONDITIONS; i++) to->conditions |= (uint32_t)(*pins->conditions[i] != 0) << i;
    for (int i = 0; i < TRUEUP_JOINTS; i++) {
        if (axis_of[i] < 0) continue;
        to->joint_now[i] = *pins->joints[i].now;
        to->joint_command[i] = *pins->joints[i].command;
        to->joint_reference[i] = *pins->joints[i].reference;
        to->joint_homing |= (uint32_t)(*pins->joints[i].homing != 0) << i;
    }
    to->spindle_rpm = *pins->spindle_rpm;
    to->load_n = *pins->load_n;
    to->sensor_v = *pins->sensor_v;
    to->tool = *pins->tool;
    to->bits = (*pins->enable ? TRUEUP_ENABLE : 0) | (*pins->machine_on ? TRUEUP_MACHINE_ON : 0)
        | (*pins->homed ? TRUEUP_HOMED : 0) | (*pins->zero ? TRUEUP_ZERO : 0) | (*pins->confirm ? TRUEUP_CONFIRM : 0)
        | (*pins->temp_heartbeat ? TRUEUP_BEAT : 0);
}

static void write_outputs(const struct trueup_outputs *from)
{
    for (int i = 0; i < 3; i++) {
        /* Wraps, as LinuxCNC's counts do. */
        *pins->axes[i].counts = (int32_t)((uint32_t)*pins->axes[i].counts + (uint32_t)from->counts[i]);
        *pins->axes[i].offset_um = from->offset_um[i];
        *pins->axes[i].applied_um = from->applied_um[i];
    }
    for (int i = 0; i < TRUEUP_JOINTS; i++) {
        if (axis_of[i] < 0) continue;
        *pins->joints[i].min = from->joint_min[i];
        *pins->joints[i].max = from->joint_max[i];
        *pins->joints[i].offset = from->joint_offset[i];
    }
    for (int i = 0; i < TRUEUP_TEMPERATURES; i++) *pins->temp[i] = from->temperature_c[i];
    *pins->elongation_um = from->elongation_um;
    *pins->quality = from->quality;
    *pins->flags = from->flags;
    *pins->state = from->state;
    *pins->age_ms = from->age_ms;
    *pins->calibration = from->calibration;
    *pins->applied = (from->bits & TRUEUP_APPLIED) != 0;
    *pins->connected = (from->bits & TRUEUP_CONNECTED) != 0;
    *pins->fault = (from->bits & TRUEUP_FAULT) != 0;
    *pins->limited = (from->bits & TRUEUP_LIMITED) != 0;
    *pins->heartbeat = (from->bits & TRUEUP_HEARTBEAT) != 0;
}

/* A servo period. */
static void step(void *unused, long period)
{
    static struct trueup_settings settings;
    static struct trueup_inputs inputs;
    static struct trueup_outputs outputs;
    (void)unused;
    if (refused) return;
    if (!started) {
        read_settings(&settings);
        *pins->scale = MM_PER_COUNT / settings.mm_per_unit;
        refused = trueup_servo_start(memory, sizeof memory, calibration, length, &settings, (uint64_t)period);
        started = 1;
        if (!refused && *heat) trueup_servo_resume(memory, heat_before, (uint32_t)loaded_s);
    }
    if (!refused) {
        read_inputs(&inputs);
        refused = trueup_servo_step(memory, &inputs, &outputs, (uint64_t)period);
    }
    if (refused) {
        /* Offsets stay as they are; the heartbeat stands, and the HAL file holds the feed. */
        *pins->fault = 1;
        *pins->applied = 0;
        *pins->connected = 0;
        *pins->quality = NOT_AVAILABLE;
        SAY("no offsets: %s\n", trueup_servo_reason(refused));
        return;
    }
    write_outputs(&outputs);
    if (heat_now) trueup_servo_retain(memory, heat_now);
}

/* Pins in one line each; they return 0, or what the HAL says. */
#define FLOAT(DIR, PLACE, START, ...) \
    (bad = bad ? bad : hal_pin_float_newf(DIR, &(PLACE), component, NAME "." __VA_ARGS__)); \
    if (!bad) *(PLACE) = (START)
#define BIT(DIR, PLACE, START, ...) \
    (bad = bad ? bad : hal_pin_bit_newf(DIR, &(PLACE), component, NAME "." __VA_ARGS__)); \
    if (!bad) *(PLACE) = (START)
#define S32(DIR, PLACE, START, ...) \
    (bad = bad ? bad : hal_pin_s32_newf(DIR, &(PLACE), component, NAME "." __VA_ARGS__)); \
    if (!bad) *(PLACE) = (START)
#define U32(DIR, PLACE, START, ...) \
    (bad = bad ? bad : hal_pin_u32_newf(DIR, &(PLACE), component, NAME "." __VA_ARGS__)); \
    if (!bad) *(PLACE) = (START)

static int make_axes(void)
{
    int bad = 0;
    for (int i = 0; i < 3; i++) {
        struct axis *axis = &pins->axes[i];
        char l = LETTERS[i];
        /* Until it is connected it says that it is not: 0 would be a position. */
        FLOAT(HAL_IN, axis->command, NAN, "%c-cmd", l);
        FLOAT(HAL_IN, axis->request, 0, "%c-request", l);
        FLOAT(HAL_IN, axis->eoffset, 0, "%c-eoffset", l);
        FLOAT(HAL_IN, axis->against_um, NAN, "%c-against-um", l);
        FLOAT(HAL_IN, axis->accel, 0, "%c-accel", l);
        BIT(HAL_IN, axis->keeps_slew, 0, "%c-keeps-slew", l);
        S32(HAL_OUT, axis->counts, 0, "%c-counts", l);
        FLOAT(HAL_OUT, axis->offset_um, 0, "%c-offset-um", l);
        FLOAT(HAL_OUT, axis->applied_um, 0, "%c-applied-um", l);
    }
    return bad;
}

static int make_joints(void)
{
    int bad = 0;
    for (int i = 0; i < TRUEUP_JOINTS; i++) {
        struct joint *joint = &pins->joints[i];
        if (axis_of[i] < 0) continue;
        FLOAT(HAL_OUT, joint->offset, 0, "joint-%d-offset", i);
        FLOAT(HAL_OUT, joint->min, 0, "joint-%d-min", i);
        FLOAT(HAL_OUT, joint->max, 0, "joint-%d-max", i);
        FLOAT(HAL_IN, joint->now, 0, "joint-%d-now", i);
        FLOAT(HAL_IN, joint->command, 0, "joint-%d-cmd", i);
        FLOAT(HAL_IN, joint->reference, 0, "joint-%d-reference", i);
        FLOAT(HAL_IN, joint->min_limit, -INFINITY, "joint-%d-min-limit", i);
        FLOAT(HAL_IN, joint->max_limit, INFINITY, "joint-%d-max-limit", i);
        BIT(HAL_IN, joint->homing, 0, "joint-%d-homing", i);
    }
    return bad;
}

static int make_inputs(void)
{
    int bad = 0;
    BIT(HAL_IN, pins->enable, 0, "enable");
    BIT(HAL_IN, pins->machine_on, 0, "machine-on");
    BIT(HAL_IN, pins->homed, 0, "homed");
    BIT(HAL_IN, pins->zero, 0, "zero");
    BIT(HAL_IN, pins->confirm, 0, "confirm");
    BIT(HAL_IN, pins->temp_heartbeat, 0, "temp-heartbeat");
    for (int i = 0; i < CONDITIONS; i++) { BIT(HAL_IN, pins->conditions[i], 0, "condition-%02d", i); }
    for (int i = 0; i < 2; i++) { FLOAT(HAL_IN, pins->angles[i], 0, "angle-%d", i + 1); }
    FLOAT(HAL_IN, pins->spindle_rpm, 0, "spindle-rpm");
    FLOAT(HAL_IN, pins->load_n, 0, "load-n");
    FLOAT(HAL_IN, pins->sensor_v, NAN, "sensor-v");
    for (int i = 0; i < TRUEUP_TEMPERATURES; i++) { FLOAT(HAL_IN, pins->temp_in[i], NAN, "temp-%02d-in", i); }
    S32(HAL_IN, pins->tool, -1, "tool");
    U32(HAL_IN, pins->temp_timeout_ms, 0, "temp-timeout-ms");
    /* 4096 codes for 3.3 V, behind the divider of the wiring, 0.328. */
    FLOAT(HAL_IN, pins->codes_per_v, 0.328 / 3.3 * 4096.0, "sensor-codes-per-v");
    FLOAT(HAL_IN, pins->resolution_v, 0.0003, "sensor-resolution-v");
    FLOAT(HAL_IN, pins->mm_per_unit, 1.0, "mm-per-unit");
    return bad;
}

static int make_outputs(void)
{
    int bad = 0;
    BIT(HAL_OUT, pins->applied, 0, "applied");
    BIT(HAL_OUT, pins->connected, 0, "connected");
    BIT(HAL_OUT, pins->fault, 0, "fault");
    BIT(HAL_OUT, pins->limited, 0, "limited");
    BIT(HAL_OUT, pins->other_calibration, 0, "other-calibration");
    BIT(HAL_OUT, pins->heartbeat, 0, "heartbeat");
    BIT(HAL_OUT, pins->enable_out, 1, "enable-out");
    for (int i = 0; i < TRUEUP_TEMPERATURES; i++) { FLOAT(HAL_OUT, pins->temp[i], NAN, "temp-%02d", i); }
    FLOAT(HAL_OUT, pins->elongation_um, NAN, "elongation-um");
    FLOAT(HAL_OUT, pins->scale, MM_PER_COUNT, "scale");
    S32(HAL_OUT, pins->quality, NOT_AVAILABLE, "quality");
    U32(HAL_OUT, pins->flags, 0, "flags");
    U32(HAL_OUT, pins->age_ms, 0, "age-ms");
    U32(HAL_OUT, pins->state, 0, "state");
    U32(HAL_OUT, pins->calibration, 0, "calibration");
    U32(HAL_OUT, pins->pid, (hal_u32_t)getpid(), "pid");
    return bad;
}

/* Reads the calibration, and tries it. */
static int load_calibration(void)
{
    struct trueup_settings settings;
    int32_t number;
    ssize_t got;
    int from = open(file, O_RDONLY | O_CLOEXEC);
    if (from < 0) {
        SAY("the calibration file=%s cannot be opened\n", file);
        return -1;
    }
    while (length < sizeof calibration && (got = read(from, calibration + length, sizeof calibration - length)) > 0)
        length += (size_t)got;
    close(from);
    memset(&settings, 0, sizeof settings);
    settings.mm_per_unit = 1.0;
    for (int i = 0; i < TRUEUP_JOINTS; i++) settings.joint_axis[i] = -1;
    number = trueup_servo_start(memory, sizeof memory, calibration, length, &settings, 1000000);
    if (number) SAY("%s: %s\n", file, trueup_servo_reason(number));
    return number ? -1 : 0;
}

/* Reads the heat from before, and makes the memory for that from now on. What does not succeed is said, and costs the
 * heat alone. */
static void load_heat(void)
{
    int from, memory_file;
    void *place;
    if (!*heat) return;
    loaded_s = time(NULL);
    from = open(heat, O_RDONLY | O_CLOEXEC);
    if (from >= 0) {
        if (read(from, heat_before, sizeof heat_before) != sizeof heat_before) memset(heat_before, 0, sizeof heat_before);
        close(from);
    }
    /* A new file: cutting one that another LinuxCNC still has mapped would end its servo thread. */
    unlink(heat_memory);
    /* The program that reads it may run as another user than rtapi_app. */
    memory_file = open(heat_memory, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
    if (memory_file < 0 || fchmod(memory_file, 0644) || ftruncate(memory_file, TRUEUP_RETAINED_BYTES)) {
        SAY("%s cannot be made: the heat is not kept over a restart\n", heat_memory);
        if (memory_file >= 0) close(memory_file);
        return;
    }
    place = mmap(NULL, TRUEUP_RETAINED_BYTES, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, memory_file, 0);
    close(memory_file);
    if (place == MAP_FAILED) SAY("%s cannot be mapped: the heat is not kept over a restart\n", heat_memory);
    else heat_now = place;
}

/* Finds the axis of each joint. */
static int read_joints(void)
{
    size_t count = strlen(joints);
    for (int i = 0; i < TRUEUP_JOINTS; i++) axis_of[i] = -1;
    if (count > TRUEUP_JOINTS) {
        SAY("joints=%s: %d at the most\n", joints, TRUEUP_JOINTS);
        return -1;
    }
    for (size_t i = 0; i < count; i++) {
        const char *at = strchr(AXES, joints[i]);
        if (at) axis_of[i] = (int)(at - AXES);
        else if (joints[i] != '.') {
            SAY("joints=%s: X, Y, Z, or a dot for a joint without an offset\n", joints);
            return -1;
        }
    }
    return 0;
}

int rtapi_app_main(void)
{
    if (load_calibration() || read_joints()) return -1;
    load_heat();
    component = hal_init("trueup_node");
    if (component < 0) return -1;
    pins = hal_malloc(sizeof *pins);
    if (!pins || make_axes() || make_joints() || make_inputs() || make_outputs()
        || hal_export_funct(NAME, step, NULL, 1, 0, component)) {
        SAY("the HAL refuses a pin of " NAME ": is the component trueup loaded as well?\n");
        hal_exit(component);
        return -1;
    }
    hal_ready(component);
    return 0;
}

void rtapi_app_exit(void)
{
    hal_exit(component);
    /* The program that keeps the heat ends with it. */
    if (heat_now) unlink(heat_memory);
}
