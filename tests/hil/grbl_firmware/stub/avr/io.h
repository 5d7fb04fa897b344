// The registers of an ATmega328P that the GRBL firmware uses, as variables of a PC program. Names and bits: its data sheet.
// board.c is the hardware behind them.
#ifndef STARBENCH_AVR_IO_H
#define STARBENCH_AVR_IO_H

#include <stdint.h>

#ifdef BOARD_OWNS_REGISTERS
#define REGISTER(type, name) volatile type name
#else
#define REGISTER(type, name) extern volatile type name
#endif

REGISTER(uint8_t, SREG);
REGISTER(uint8_t, DDRB); REGISTER(uint8_t, DDRC); REGISTER(uint8_t, DDRD);
REGISTER(uint8_t, PORTB); REGISTER(uint8_t, PORTC); REGISTER(uint8_t, PORTD);
REGISTER(uint8_t, PINB); REGISTER(uint8_t, PINC); REGISTER(uint8_t, PIND);
REGISTER(uint8_t, TCCR0A); REGISTER(uint8_t, TCCR0B); REGISTER(uint8_t, TCCR1A); REGISTER(uint8_t, TCCR1B);
REGISTER(uint8_t, TCCR2A); REGISTER(uint8_t, TCCR2B);
REGISTER(uint8_t, TIMSK0); REGISTER(uint8_t, TIMSK1); REGISTER(uint8_t, TCNT0);
REGISTER(uint8_t, OCR0A); REGISTER(uint8_t, OCR2A); REGISTER(uint16_t, OCR1A); REGISTER(uint16_t, TCNT1);
REGISTER(uint8_t, PCICR); REGISTER(uint8_t, PCMSK0); REGISTER(uint8_t, PCMSK1);
REGISTER(uint8_t, MCUSR); REGISTER(uint8_t, WDTCSR);
REGISTER(uint8_t, UCSR0A); REGISTER(uint8_t, UCSR0B); REGISTER(uint8_t, UDR0);
REGISTER(uint8_t, UBRR0H); REGISTER(uint8_t, UBRR0L);
REGISTER(uint16_t, EEAR);

// The memory answers at once: reading and writing EEDR touch the byte at EEAR, and a write has always ended.
volatile uint8_t *eeprom_data(void);
volatile uint8_t *eeprom_control(void);
#define EEDR (*eeprom_data())
#define EECR (*eeprom_control())

#define EERE 0
#define EEPE 1
#define EEMPE 2
enum { CS00 = 0, CS01 = 1, CS02 = 2, CS10 = 0, CS11 = 1, CS12 = 2, CS20 = 0, CS21 = 1, CS22 = 2 };
enum { WGM10 = 0, WGM11 = 1, WGM12 = 3, WGM13 = 4, WGM20 = 0, WGM21 = 1 };
enum { COM1B0 = 4, COM1B1 = 5, COM1A0 = 6, COM1A1 = 7, COM2A1 = 7 };
enum { TOIE0 = 0, OCIE0A = 1, OCIE0B = 2, OCIE1A = 1, PCIE0 = 0, PCIE1 = 1 };
enum { U2X0 = 1, TXEN0 = 3, RXEN0 = 4, UDRIE0 = 5, RXCIE0 = 7 };

#endif
