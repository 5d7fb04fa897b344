// Stand-ins for the names of an ATmega328P that the sketch uses: they only let a compiler read it.
#pragma once
#include <stdint.h>
#define _BV(bit) (1 << (bit))
#define F_CPU 16000000UL
enum { HIGH = 1, LOW = 0, OUTPUT = 1, INPUT_PULLUP = 2 };
enum { COM2B1 = 5, WGM21 = 1, WGM20 = 0, CS20 = 0, CS10 = 0, CS11 = 1, CS12 = 2 };
enum { WGM13 = 4, WGM12 = 3, WGM11 = 1, COM1A1 = 7, COM1B1 = 5 };
extern volatile uint8_t TCCR2A, TCCR2B, OCR2B, TCCR1A, TCCR1B;
extern volatile uint16_t ICR1, OCR1A, OCR1B, TCNT1;
uint32_t millis();
void pinMode(int pin, int mode);
void digitalWrite(int pin, int value);
int digitalRead(int pin);
void noInterrupts();
void interrupts();
struct StubSerial {
  void begin(long baud);
  int available();
  int read();
  void write(char c);
};
extern StubSerial Serial;
