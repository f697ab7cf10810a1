/*
 * Start of a PowerPC 750 without an operating system, and the way into its interrupts.
 *
 * Everything runs in real mode (no address translation), with floating point on.
 */
    .set MSR_FP, 0x2000
    .set MSR_RI, 0x0002

    .section .text.start, "ax"
    .globl _start
_start:
    li      3, MSR_FP | MSR_RI          /* no external interrupt, no translation, vectors at 0 */
    mtsrr1  3
    lis     3, begin@ha
    addi    3, 3, begin@l
    mtsrr0  3
    rfi
begin:
    lis     1, pf_stack_top@ha
    addi    1, 1, pf_stack_top@l
    li      0, 0
    stwu    0, -16(1)                   /* the end of the back chain */
    lis     3, pf_bss_begin@ha
    addi    3, 3, pf_bss_begin@l
    lis     4, pf_bss_end@ha
    addi    4, 4, pf_bss_end@l
1:  cmplw   3, 4
    bge     2f
    stw     0, 0(3)
    addi    3, 3, 4
    b       1b
2:  mtfsf   0xff, 0                     /* set below: round to nearest, no exception enabled */
    lis     3, pf_zero@ha
    lfd     0, pf_zero@l(3)
    mtfsf   0xff, 0
    bl      pf_board_main
3:  b       3b

/* The decrementer's interrupt: what a C function may change is saved around pf_board_tick. */
    .globl pf_tick_entry
pf_tick_entry:
    stwu    1, -224(1)
    stw     0, 8(1)
    stmw    3, 12(1)                    /* r3 to r31: 29 words, to 128 */
    mflr    3
    mfctr   4
    mfxer   5
    mfcr    6
    mfsrr0  7
    mfsrr1  8
    stw     3, 128(1)
    stw     4, 132(1)
    stw     5, 136(1)
    stw     6, 140(1)
    stw     7, 144(1)
    stw     8, 148(1)
    mfmsr   3
    ori     3, 3, MSR_FP                /* an interrupt turns it off */
    mtmsr   3
    isync
    stfd    0, 152(1)                   /* the loop that is interrupted uses no other */
    mffs    0
    stfd    0, 160(1)
    bl      pf_board_tick
    lfd     0, 160(1)
    mtfsf   0xff, 0
    lfd     0, 152(1)
    lwz     3, 128(1)
    lwz     4, 132(1)
    lwz     5, 136(1)
    lwz     6, 140(1)
    lwz     7, 144(1)
    lwz     8, 148(1)
    mtlr    3
    mtctr   4
    mtxer   5
    mtcr    6
    mtsrr0  7
    mtsrr1  8
    lwz     0, 8(1)
    lmw     3, 12(1)
    addi    1, 1, 224
    rfi

/* Any other exception: its vector is in r3, where it happened in SRR0. It does not return. */
    .globl pf_fault_entry
pf_fault_entry:
    lis     1, pf_stack_top@ha
    addi    1, 1, pf_stack_top@l
    li      0, 0
    stwu    0, -16(1)
    mfsrr0  4
    bl      pf_board_fault
4:  b       4b

/* void pf_firmware(const uint32_t *call): asks the firmware below, as RTAS does. */
    .globl pf_firmware
pf_firmware:
    mr      4, 3
    li      3, 0
    ori     3, 3, 0xf000
    .long   0x44000022                  /* sc 1 */
    blr

    .section .rodata.zero, "a"
    .balign 8
pf_zero:
    .quad   0
