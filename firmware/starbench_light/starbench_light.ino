// Copyright 2026 The Starbench authors
// SPDX-License-Identifier: Apache-2.0
//
// Starbench microcontroller light for an Arduino Uno or Nano (ATmega328P, 16 MHz).
//
//   pin 9   OC1A  gate of the LED driver: high = lit. Timer 1 makes the flicker without the program's help.
//   pin 10  OC1B  sync output to the camera's trigger input: the same edges, from the same timer.
//   pin 3   OC2B  brightness: PWM of 62.5 kHz, through a low-pass to the analogue input of the LED driver.
//   pin 4         thermal switch to ground: closed = cool. Open = too hot, or the wire is broken.
//
// A pull-down of 10 kOhm at pin 9 keeps the light dark while the board starts. The light is dark after every reset, when
// the computer says nothing for DOG seconds, and when the program hangs for 0.5 s (the chip's own watchdog).
// Give every light its own serial number.

#include <Arduino.h>
#include <avr/wdt.h>

#include "light_protocol.h"

static const char kSerial[] = "SB0001";
static const char kVersion[] = "1.0";

class Uno : public LightBoard {
 public:
  void begin() {
    output(false, false, false);
    pinMode(9, OUTPUT);
    pinMode(10, OUTPUT);
    pinMode(3, OUTPUT);
    pinMode(4, INPUT_PULLUP);
    TCCR2A = _BV(COM2B1) | _BV(WGM21) | _BV(WGM20);  // fast PWM, 62.5 kHz
    TCCR2B = _BV(CS20);
    OCR2B = 0;
  }

  uint32_t now_ms() override { return millis(); }
  void put(char c) override { Serial.write(c); }

  void timer(uint16_t prescaler, uint32_t ticks, uint32_t high) override {
    const uint8_t divider = prescaler == 1      ? _BV(CS10)
                            : prescaler == 8    ? _BV(CS11)
                            : prescaler == 64   ? _BV(CS11) | _BV(CS10)
                            : prescaler == 256  ? _BV(CS12)
                                                : _BV(CS12) | _BV(CS10);
    noInterrupts();
    TCCR1B = _BV(WGM13) | _BV(WGM12);  // stopped, fast PWM up to ICR1
    ICR1 = static_cast<uint16_t>(ticks - 1);
    OCR1A = static_cast<uint16_t>(high > 0 ? high - 1 : 0);
    OCR1B = OCR1A;
    TCNT1 = 0;
    TCCR1B = _BV(WGM13) | _BV(WGM12) | divider;
    interrupts();
  }

  void level(uint8_t of_255) override { OCR2B = of_255; }

  void output(bool on, bool steady, bool sync) override {
    // Pins that the timer does not drive have these levels.
    digitalWrite(9, on && steady ? HIGH : LOW);
    digitalWrite(10, LOW);
    uint8_t control = _BV(WGM11);
    if (on && !steady) control |= _BV(COM1A1);
    if (sync) control |= _BV(COM1B1);
    TCCR1A = control;
  }

  bool too_hot() override { return digitalRead(4) == HIGH; }
};

static Uno board;
static LightProtocol light(board, F_CPU, kSerial, kVersion);

void setup() {
  board.begin();
  light.begin();
  Serial.begin(115200);
  wdt_enable(WDTO_500MS);
}

void loop() {
  wdt_reset();
  while (Serial.available() > 0) light.take(static_cast<char>(Serial.read()));
  light.watch();
}
