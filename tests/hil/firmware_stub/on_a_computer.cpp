// The firmware's protocol on a computer: standard input and output are the serial line, standard error is the light.
#include <poll.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

#include "light_protocol.h"

struct Computer : LightBoard {
  uint32_t now_ms() override {
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<uint32_t>(now.tv_sec * 1000 + now.tv_nsec / 1000000);
  }
  void put(char c) override { putchar(c); }
  void timer(uint16_t prescaler, uint32_t ticks, uint32_t high) override {
    fprintf(stderr, "timer %u %u %u\n", prescaler, ticks, high);
  }
  void level(uint8_t of_255) override { fprintf(stderr, "level %u\n", of_255); }
  void output(bool on, bool steady, bool sync) override {
    fprintf(stderr, "output %d %d %d\n", on, steady, sync);
  }
  bool too_hot() override { return false; }
};

int main() {
  Computer computer;
  LightProtocol light(computer, 16000000UL, "SB0001", "1.0");
  light.begin();
  for (;;) {
    pollfd waiting = {0, POLLIN, 0};
    if (poll(&waiting, 1, 50) > 0) {
      char bytes[64];
      const ssize_t count = read(0, bytes, sizeof bytes);
      if (count <= 0) return 0;
      for (ssize_t i = 0; i < count; ++i) light.take(bytes[i]);
    }
    light.watch();
    fflush(stdout);
  }
}
