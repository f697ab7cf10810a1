/*
 * A flight as a Linux program: a frame on standard input; on standard output an answer, and unless
 * that names a fault, a record a period. Ends with 0 after a flight, 2 where it refused, 3 where
 * the pipe broke.
 */
#include "pf_flight.h"

#include <stdio.h>

static pf_frame_t frame;
static pf_record_t record; /* static: what lies between the members is zero */
static pf_flight_t flight;

int main(void)
{
    uint32_t answer[3] = {PF_FLIGHT_MAGIC, 0U, (uint32_t)sizeof(pf_record_t)};
    uint32_t k;

    if (fread(&frame, 1U, sizeof frame, stdin) != sizeof frame) {
        answer[1] = PF_FAULT_LENGTH;
    } else {
        answer[1] = pf_flight_check(&frame, UINT32_MAX);
    }
    if (fwrite(answer, sizeof answer, 1U, stdout) != 1U) {
        return 3;
    }
    if (answer[1] != 0U) {
        return (fflush(stdout) == 0) ? 2 : 3;
    }
    pf_flight_begin(&flight, &frame);
    for (k = 0U; k < frame.steps; ++k) {
        pf_flight_measure(&flight, &record);
        pf_flight_control(&flight, &record);
        pf_flight_advance(&flight, &record);
        if (fwrite(&record, sizeof record, 1U, stdout) != 1U) {
            return 3;
        }
    }
    return (fflush(stdout) == 0) ? 0 : 3;
}
