/*
 * A flight on a bare PowerPC 750 (QEMU's pegasos2): the control step runs inside the decrementer's
 * interrupt, the simulated plant after it in the same interrupt, where a real one would wait
 * outside. The loop below only sleeps.
 *
 * The host leaves the frame in the mailbox before the start, as a debug probe would, and takes the
 * report and the records from memory at the end.
 */
#include "pf_flight.h"

/* Time base and decrementer count at 33.333 MHz on this board. */
#define TIME_BASE_HZ 33333333.0

#define UART ((volatile uint8_t *)0xfe0002f8U)
#define UART_LINE_STATUS 5
#define UART_READY 0x20U
#define I8259_MASK_1 ((volatile uint8_t *)0xfe000021U)
#define I8259_MASK_2 ((volatile uint8_t *)0xfe0000a1U)

#define MSR_SLEEP 0x00040000U
#define MSR_INTERRUPTS 0x00008000U
#define MSR_BASE 0x00002002U /* floating point, recoverable */
#define HID0_DOZE 0x00800000U
#define FIRST_VECTOR 0x100U
#define LAST_VECTOR 0x1700U
#define DECREMENTER 0x900U

/* What the host finds beside the frame; `magic` is written last. */
typedef struct {
    uint32_t magic;
    uint32_t fault;       /* of pf_flight_check */
    uint32_t vector;      /* of an exception that ended it, or 0 */
    uint32_t address;     /* where that happened */
    uint32_t periods;     /* flown */
    uint32_t period_ticks;
    uint32_t overruns;    /* periods that ended after the next one was due */
    uint32_t missed;      /* periods left out, because their time had passed */
    uint32_t step_ticks;  /* the longest control step */
    uint32_t tick_ticks;  /* the longest interrupt, plant and log included */
    uint32_t late_ticks;  /* the latest start */
    uint32_t stack_bytes; /* below the top, as far as it was touched */
} pf_board_report_t;

typedef struct {
    pf_frame_t frame;
    uint32_t forced_period_ticks; /* unless 0, the period: shorter than a step, it must overrun */
    uint32_t kept; /* records: unless 0, each takes the place of the one so many periods before */
    pf_board_report_t report;
} pf_mailbox_t;

extern pf_mailbox_t pf_mailbox;
extern pf_record_t pf_records[];
extern unsigned char pf_records_end[];
extern unsigned char pf_bss_end[];
extern unsigned char pf_stack_top[];
extern void pf_tick_entry(void);
extern void pf_fault_entry(void);
extern void pf_firmware(const uint32_t *call);

void pf_board_main(void);
void pf_board_tick(void);
void pf_board_fault(uint32_t vector, uint32_t address);
void *memcpy(void *to, const void *from, __SIZE_TYPE__ n);
void *memset(void *to, int value, __SIZE_TYPE__ n);

static pf_flight_t flight;
static pf_board_report_t report;
static volatile uint32_t done;

static uint32_t time_base(void)
{
    uint32_t ticks;
    __asm__ volatile("mftb %0" : "=r"(ticks));
    return ticks;
}

static int32_t decrementer(void)
{
    int32_t left;
    __asm__ volatile("mfdec %0" : "=r"(left));
    return left;
}

static void set_decrementer(int32_t left)
{
    __asm__ volatile("mtdec %0" : : "r"(left));
}

static void say(const char *text)
{
    for (; *text != '\0'; ++text) {
        while ((UART[UART_LINE_STATUS] & UART_READY) == 0U) {
        }
        UART[0] = (uint8_t)*text;
    }
}

static void say_number(const char *name, uint32_t value)
{
    char digits[11];
    uint32_t k = 10U;

    digits[10] = '\0';
    do {
        digits[--k] = (char)('0' + (char)(value % 10U));
        value /= 10U;
    } while (value != 0U);
    say(name);
    say(&digits[k]);
}

static void power_off(void)
{
    static const uint32_t call[] = {17U, 2U, 1U, 0U, 0U, 0U}; /* power-off, two words in, one out */

    pf_firmware(call);
}

static void leave(void)
{
    const unsigned char *low = pf_bss_end;

    while (*low == 0xa5U && low < pf_stack_top) {
        ++low;
    }
    report.stack_bytes = (uint32_t)(pf_stack_top - low);
    report.magic = PF_FLIGHT_MAGIC;
    pf_mailbox.report = report;
    say_number("periods ", report.periods);
    say_number(" overruns ", report.overruns);
    say_number(" fault ", report.fault);
    say_number(" vector ", report.vector);
    say("\n");
    power_off();
}

/* Puts the way to an entry at each vector; a branch to an absolute address reaches 32 MiB. */
static void set_vectors(void)
{
    uint32_t at;

    for (at = FIRST_VECTOR; at <= LAST_VECTOR; at += 0x100U) {
        volatile uint32_t *place = (volatile uint32_t *)at;
        const int tick = (at == DECREMENTER);
        const uint32_t to = (uint32_t)(tick ? pf_tick_entry : pf_fault_entry);

        place[0] = tick ? 0x60000000U : (0x38600000U | at); /* nop, or li r3, vector */
        place[1] = 0x48000002U | (to & 0x03fffffcU);        /* ba entry */
        __asm__ volatile("dcbst 0, %0; sync; icbi 0, %0" : : "r"(place) : "memory");
    }
    __asm__ volatile("sync; isync");
}

void pf_board_fault(uint32_t vector, uint32_t address)
{
    report.vector = vector;
    report.address = address;
    leave();
}

/*
 * The next period on the grid of the first. Where that is past already, the decrementer would not
 * pass zero again before it has gone all the way round: what was missed is left out and counted.
 */
static void set_next_period(void)
{
    int32_t next = decrementer() + (int32_t)report.period_ticks;

    while (next <= 0) {
        next += (int32_t)report.period_ticks;
        ++report.missed;
    }
    set_decrementer(next);
}

void pf_board_tick(void)
{
    const uint32_t begun = time_base();
    const int32_t left = decrementer(); /* below zero by as much as this is late */
    const uint32_t kept = pf_mailbox.kept;
    pf_record_t *record = &pf_records[(kept != 0U) ? (flight.period % kept) : flight.period];
    uint32_t before, ticks;

    set_next_period();
    if (done != 0U) {
        return;
    }
    if (left < 0 && (uint32_t)(-left) > report.late_ticks) {
        report.late_ticks = (uint32_t)(-left);
    }
    pf_flight_measure(&flight, record);
    before = time_base();
    pf_flight_control(&flight, record);
    record->ticks = time_base() - before;
    if (record->ticks > report.step_ticks) {
        report.step_ticks = record->ticks;
    }
    pf_flight_advance(&flight, record);
    ++report.periods;
    if (flight.period >= flight.frame->steps) {
        done = 1U;
    }
    ticks = time_base() - begun;
    if (ticks > report.tick_ticks) {
        report.tick_ticks = ticks;
    }
    if (decrementer() < 0) {
        ++report.overruns;
    }
}

void pf_board_main(void)
{
    const uint32_t room = (uint32_t)(pf_records_end - (unsigned char *)pf_records)
        / (uint32_t)sizeof(pf_record_t);
    uint32_t asleep = MSR_BASE | MSR_INTERRUPTS | MSR_SLEEP;
    unsigned char *low;
    uint32_t hid0;

    *I8259_MASK_1 = 0xffU;
    *I8259_MASK_2 = 0xffU;
    set_decrementer(INT32_MAX);
    set_vectors();
    for (low = pf_bss_end; low < (unsigned char *)__builtin_frame_address(0) - 256; ++low) {
        *low = 0xa5U;
    }
    report.fault = pf_flight_check(&pf_mailbox.frame, (pf_mailbox.kept != 0U) ? UINT32_MAX : room);
    if (pf_mailbox.kept > room) {
        report.fault |= PF_FAULT_LENGTH;
    }
    if (report.fault != 0U || pf_mailbox.frame.steps == 0U) {
        leave();
        return;
    }
    report.period_ticks = (uint32_t)(TIME_BASE_HZ * pf_mailbox.frame.sample_time + 0.5);
    if (pf_mailbox.forced_period_ticks != 0U) {
        report.period_ticks = pf_mailbox.forced_period_ticks;
    }
    pf_flight_begin(&flight, &pf_mailbox.frame);
    __asm__ volatile("mfspr %0, 1008" : "=r"(hid0));
    __asm__ volatile("mtspr 1008, %0" : : "r"(hid0 | HID0_DOZE));
    set_decrementer((int32_t)report.period_ticks);
    while (done == 0U) { /* between periods the processor dozes */
        __asm__ volatile("sync; mtmsr %0; isync" : : "r"(asleep) : "memory");
    }
    __asm__ volatile("mtmsr %0; isync" : : "r"(MSR_BASE) : "memory");
    leave();
}

/* The compiler copies structures by these. */
void *memcpy(void *to, const void *from, __SIZE_TYPE__ n)
{
    volatile unsigned char *place = to; /* volatile: else this is made a call of itself */
    const unsigned char *source = from;

    while (n-- > 0U) {
        *place++ = *source++;
    }
    return to;
}

void *memset(void *to, int value, __SIZE_TYPE__ n)
{
    volatile unsigned char *place = to;

    while (n-- > 0U) {
        *place++ = (unsigned char)value;
    }
    return to;
}
