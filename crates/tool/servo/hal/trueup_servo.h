/* The C interface of the library trueup_servo; crates/tool/servo/src/abi.rs defines the same. */
#ifndef TRUEUP_SERVO_H
#define TRUEUP_SERVO_H

#include <stddef.h>
#include <stdint.h>

#define TRUEUP_SERVO_BYTES 65536
#define TRUEUP_JOINTS 9
#define TRUEUP_TEMPERATURES 8
#define TRUEUP_RETAINED_BYTES 1224

struct trueup_settings {
    double mm_per_unit, codes_per_v, resolution_v;
    double against_um[3], acceleration[3];
    double joint_min[TRUEUP_JOINTS], joint_max[TRUEUP_JOINTS];
    int32_t joint_axis[TRUEUP_JOINTS];
    uint32_t temperature_timeout_ms, planner_keeps_slew, sends_rotary;
};

enum { TRUEUP_ENABLE = 1, TRUEUP_MACHINE_ON = 2, TRUEUP_HOMED = 4, TRUEUP_ZERO = 8, TRUEUP_CONFIRM = 16, TRUEUP_BEAT = 32 };

struct trueup_inputs {
    double position[3], request[3], eoffset[3], angles_deg[2];
    double spindle_rpm, load_n, sensor_v;
    double temperature_c[TRUEUP_TEMPERATURES];
    double joint_now[TRUEUP_JOINTS], joint_command[TRUEUP_JOINTS], joint_reference[TRUEUP_JOINTS];
    int32_t tool;
    uint32_t conditions, joint_homing, bits;
};

enum { TRUEUP_APPLIED = 1, TRUEUP_CONNECTED = 2, TRUEUP_FAULT = 4, TRUEUP_LIMITED = 8, TRUEUP_HEARTBEAT = 16 };

struct trueup_outputs {
    double offset_um[3], applied_um[3];
    double joint_offset[TRUEUP_JOINTS], joint_min[TRUEUP_JOINTS], joint_max[TRUEUP_JOINTS];
    double temperature_c[TRUEUP_TEMPERATURES];
    double elongation_um;
    int32_t counts[3], quality;
    uint32_t flags, state, age_ms, calibration, bits;
};

int32_t trueup_servo_start(uint8_t *memory, size_t size, const uint8_t *blob, size_t length,
                           const struct trueup_settings *settings, uint64_t period_ns);
int32_t trueup_servo_step(uint8_t *memory, const struct trueup_inputs *inputs, struct trueup_outputs *outputs,
                          uint64_t period_ns);
void trueup_servo_resume(uint8_t *memory, const uint8_t *copies, uint32_t now_s);
int32_t trueup_servo_retain(uint8_t *memory, uint8_t *copies);
const char *trueup_servo_reason(int32_t number);

#endif
