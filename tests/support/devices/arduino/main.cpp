// A device built on the vendor's own library for devices (DYNAMIXEL::Slave), with its bus on standard input and
// output: main MODEL_NUMBER FIRMWARE ID ADDRESS:SIZE ... Items hold zeros at the start; all may be written.
#include <poll.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

#include <cstdio>
#include <vector>

#include "slave.h"

static unsigned long since_start(long per_second) {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (unsigned long)(now.tv_sec * per_second + now.tv_nsec / (1000000000L / per_second));
}

unsigned long millis() { return since_start(1000L); }
unsigned long micros() { return since_start(1000000L); }

class Pipe : public DXLPortHandler {
 public:
  void begin() override { setOpenState(true); }
  void end() override { setOpenState(false); }
  int available() override {
    int waiting = 0;
    return ioctl(0, FIONREAD, &waiting) == 0 ? waiting : 0;
  }
  int read() override {
    uint8_t byte;
    return ::read(0, &byte, 1) == 1 ? byte : -1;
  }
  size_t write(uint8_t byte) override { return ::write(1, &byte, 1) == 1 ? 1 : 0; }
  size_t write(uint8_t *bytes, size_t size) override {
    ssize_t written = ::write(1, bytes, size);
    return written < 0 ? 0 : (size_t)written;
  }
};

int main(int count, char **words) {
  if (count < 4) return 2;
  static Pipe port;
  // Static, so that its memory is zeros: the library looks at the entry behind its last item before it is made.
  static DYNAMIXEL::Slave device(port, (uint16_t)atoi(words[1]));
  device.setFirmwareVersion((uint8_t)atoi(words[2]));
  device.setID((uint8_t)atoi(words[3]));
  device.setReadCallbackFunc(nullptr);
  device.setWriteCallbackFunc(nullptr);
  std::vector<std::vector<uint8_t>> items;
  for (int k = 4; k < count; k++) {
    int address, size;
    if (sscanf(words[k], "%d:%d", &address, &size) != 2) return 2;
    items.emplace_back((size_t)size, (uint8_t)0);
    if (device.addControlItem((uint16_t)address, items.back().data(), (uint16_t)size) != DXL_LIB_OK) return 3;
  }
  device.begin();
  pollfd waiting = {0, POLLIN, 0};
  while (poll(&waiting, 1, -1) >= 0) {
    if (waiting.revents & POLLIN) {
      while (port.available() > 0) device.processPacket();
    } else {
      return 0;  // the other side is gone
    }
  }
  return 0;
}
