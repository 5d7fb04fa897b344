// Copyright 2026 The Starbench authors
// SPDX-License-Identifier: Apache-2.0
//
// The line protocol of the Starbench microcontroller light, version 1, without any hardware.
// docs/protocols/starbench-light.md describes it. Whole numbers only: no floating point, no memory allocation.
#pragma once

#include <stdint.h>
#include <string.h>

// What the protocol needs of a board. The sketch implements it for an ATmega328P, a test for a computer.
struct LightBoard {
  virtual uint32_t now_ms() = 0;
  virtual void put(char c) = 0;                                              // one byte to the computer
  virtual void timer(uint16_t prescaler, uint32_t ticks, uint32_t high) = 0;  // period and high part, in ticks
  virtual void level(uint8_t of_255) = 0;                                    // brightness while the light is lit
  virtual void output(bool on, bool steady, bool sync) = 0;                  // dark, steady, or flickering
  virtual bool too_hot() = 0;
};

class LightProtocol {
 public:
  LightProtocol(LightBoard& board, uint32_t clock_hz, const char* serial, const char* version)
      : board_(board), clock_hz_(clock_hz), serial_(serial), version_(version) {}

  void begin() {
    heard_ms_ = board_.now_ms();
    set_frequency(60000000ULL);
    board_.level(0);
    board_.output(false, false, false);
  }

  // Call it for each byte from the computer.
  void take(char c) {
    if (c == '\r') return;
    if (c != '\n') {
      if (length_ < kLongest) line_[length_] = c;
      if (length_ <= kLongest) ++length_;
      return;
    }
    if (length_ > 0 && length_ <= kLongest) {
      line_[length_] = 0;
      answer_line();
    }
    length_ = 0;
  }

  // Call it often: the watchdog and the thermal switch.
  void watch() {
    if (board_.too_hot() && fault_ != kHot) {
      fault_ = kHot;
      dark();
    }
    if (on_ && board_.now_ms() - heard_ms_ > dog_s_ * 1000UL) {
      fault_ = kWatchdog;
      dark();
    }
  }

 private:
  enum Fault { kNone, kWatchdog, kHot };
  enum Error { kFine = 0, kChecksum = 1, kUnknown = 2, kValue = 3, kRange = 4, kLatched = 5 };
  static const uint8_t kLongest = 60;

  // ---------------------------------------------------------------- lines
  void answer_line() {
    sum_ = 0;
    char* star = strrchr(line_, '*');
    if (star == nullptr || !checksum_fits(star)) {
      say("? err 1");
      end_line();
      return;
    }
    *star = 0;
    heard_ms_ = board_.now_ms();
    say(line_);
    say(" ");
    char* value = strchr(line_, ' ');
    if (value != nullptr) *value++ = 0;
    if (!told(value)) {
      const Error error = carry_out(value == nullptr ? "" : value);
      if (error == kFine) {
        say("ok");
      } else {
        say("err ");
        say_number(error);
      }
    }
    end_line();
  }

  bool checksum_fits(const char* star) const {
    uint8_t sum = 0;
    for (const char* c = line_; c < star; ++c) sum ^= static_cast<uint8_t>(*c);
    return star[1] == digit(sum >> 4) && star[2] == digit(sum & 15) && star[3] == 0;
  }

  bool is(const char* name) const { return strcmp(line_, name) == 0; }

  bool told(const char* value) {
    if (value != nullptr) return false;
    if (is("ID?")) {
      say("= STARLIGHT 1 ");
      say(version_);
    } else if (is("SERIAL?")) {
      say("= ");
      say(serial_);
    } else if (is("WAVE?")) {
      say(steady_ ? "= steady" : "= square");
    } else if (is("FREQ?")) {
      say("= ");
      say_fixed((clock_hz_ * 1000000ULL + prescaler_ * ticks_ / 2) / (prescaler_ * ticks_), 6);
    } else if (is("DUTY?")) {
      say("= ");
      say_fixed((high_ * 1000000ULL + ticks_ / 2) / ticks_, 4);
    } else if (is("LEVEL?")) {
      say("= ");
      say_fixed(level_, 2);
    } else if (is("SYNC?")) {
      say(sync_ ? "= on" : "= off");
    } else if (is("OUT?")) {
      say(on_ ? "= on" : "= off");
    } else if (is("DOG?")) {
      say("= ");
      say_number(dog_s_);
    } else if (is("FAULT?")) {
      say(fault_ == kHot ? "= hot" : fault_ == kWatchdog ? "= watchdog" : "= none");
    } else {
      return false;
    }
    return true;
  }

  Error carry_out(const char* value) {
    uint64_t micro = 0;
    const bool number = parse(value, &micro);
    if (is("ON") || is("OFF")) {
      if (*value != 0) return kValue;
      if (is("ON") && fault_ == kHot) return kLatched;
      if (is("ON")) fault_ = kNone;
      on_ = is("ON");
    } else if (is("WAVE")) {
      if (strcmp(value, "square") != 0 && strcmp(value, "steady") != 0) return kValue;
      steady_ = strcmp(value, "steady") == 0;
    } else if (is("SYNC")) {
      if (strcmp(value, "on") != 0 && strcmp(value, "off") != 0) return kValue;
      sync_ = strcmp(value, "on") == 0;
    } else if (is("FREQ")) {
      if (!number) return kValue;
      if (micro < 500000ULL || micro > 5000000000ULL) return kRange;
      set_frequency(micro);
    } else if (is("DUTY")) {
      if (!number) return kValue;
      if (micro < 1000000ULL || micro > 99000000ULL) return kRange;
      duty_ = static_cast<uint32_t>(micro);
      set_timer();
    } else if (is("LEVEL")) {
      if (!number) return kValue;
      if (micro > 100000000ULL) return kRange;
      level_ = static_cast<uint32_t>((micro + 5000) / 10000);
      board_.level(static_cast<uint8_t>((level_ * 255UL + 5000) / 10000));
    } else if (is("DOG")) {
      if (!number) return kValue;
      if (micro < 1000000ULL || micro > 3600000000ULL) return kRange;
      dog_s_ = static_cast<uint32_t>(micro / 1000000ULL);
    } else {
      return kUnknown;
    }
    board_.output(on_, steady_, on_ && sync_ && !steady_);
    return kFine;
  }

  // ---------------------------------------------------------------- light
  void dark() {
    on_ = false;
    board_.output(false, steady_, false);
  }

  void set_frequency(uint64_t micro_hz) {
    static const uint16_t kPrescalers[] = {1, 8, 64, 256, 1024};
    for (uint8_t i = 0; i < 5; ++i) {
      const uint64_t step = micro_hz * kPrescalers[i];
      const uint64_t ticks = (clock_hz_ * 1000000ULL + step / 2) / step;
      prescaler_ = kPrescalers[i];
      ticks_ = static_cast<uint32_t>(ticks);
      if (ticks <= 65536ULL) break;
    }
    set_timer();
  }

  void set_timer() {
    high_ = static_cast<uint32_t>((static_cast<uint64_t>(duty_) * ticks_ + 50000000ULL) / 100000000ULL);
    board_.timer(static_cast<uint16_t>(prescaler_), ticks_, high_);
  }

  // ---------------------------------------------------------------- text
  // Reads a plain decimal number in millionths; at most 6 decimals count.
  static bool parse(const char* text, uint64_t* micro) {
    uint64_t value = 0;
    int8_t decimals = -1;
    uint8_t digits = 0;
    for (; *text != 0; ++text) {
      if (*text == '.') {
        if (decimals >= 0) return false;
        decimals = 0;
        continue;
      }
      if (*text < '0' || *text > '9' || ++digits > 15) return false;
      if (decimals >= 6) continue;
      value = value * 10 + static_cast<uint8_t>(*text - '0');
      if (decimals >= 0) ++decimals;
    }
    for (int8_t i = decimals < 0 ? 0 : decimals; i < 6; ++i) value *= 10;
    *micro = value;
    return digits > 0;
  }

  static char digit(uint8_t value) { return static_cast<char>(value < 10 ? '0' + value : 'A' + value - 10); }

  void say(const char* text) {
    for (; *text != 0; ++text) {
      sum_ ^= static_cast<uint8_t>(*text);
      board_.put(*text);
    }
  }

  void say_number(uint64_t value) {
    char text[21];
    uint8_t at = 20;
    text[at] = 0;
    do {
      text[--at] = static_cast<char>('0' + value % 10);
      value /= 10;
    } while (value > 0);
    say(text + at);
  }

  void say_fixed(uint64_t value, uint8_t decimals) {
    uint64_t unit = 1;
    for (uint8_t i = 0; i < decimals; ++i) unit *= 10;
    say_number(value / unit);
    char text[8];
    uint64_t rest = value % unit;
    text[decimals + 1] = 0;
    for (uint8_t i = decimals; i > 0; --i) {
      text[i] = static_cast<char>('0' + rest % 10);
      rest /= 10;
    }
    text[0] = '.';
    say(text);
  }

  void end_line() {
    const uint8_t sum = sum_;
    board_.put('*');
    board_.put(digit(sum >> 4));
    board_.put(digit(sum & 15));
    board_.put('\r');
    board_.put('\n');
  }

  LightBoard& board_;
  uint64_t clock_hz_;
  const char* serial_;
  const char* version_;
  char line_[kLongest + 1] = {0};
  uint8_t length_ = 0;
  uint8_t sum_ = 0;
  bool on_ = false;
  bool steady_ = false;
  bool sync_ = true;
  uint64_t prescaler_ = 8;
  uint32_t ticks_ = 33333;
  uint32_t high_ = 16667;
  uint32_t duty_ = 50000000;  // millionths of a per cent
  uint32_t level_ = 0;        // hundredths of a per cent
  uint32_t dog_s_ = 60;
  uint32_t heard_ms_ = 0;
  Fault fault_ = kNone;
};
