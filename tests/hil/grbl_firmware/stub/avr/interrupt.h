// Interrupts of the PC program: board.c calls a handler while the interrupt flag of SREG is set.
#ifndef STARBENCH_AVR_INTERRUPT_H
#define STARBENCH_AVR_INTERRUPT_H

#include <avr/io.h>

#define ISR(handler) void handler(void)
#define sei() ((void)(SREG |= 0x80))
#define cli() ((void)(SREG &= 0x7F))

#endif
